"""What rorg finds in a robot beside mistakes of form: each code by a tree with the mistake, and one without it."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path

import pytest
import yaml
from common import ROOT
from finding_cases import build
from hypothesis import given, settings
from hypothesis import strategies as st

from rorg.errors import advice
from rorg.manifest.load import MOST_TOLD, load
from rorg.manifest.validation import idle, texts
from rorg.manifest.validation.codes import CODES
from rorg.manifest.validation.run import validate

FOLDER = ROOT / "tests/cases/findings"
CASES = sorted(path.stem for path in FOLDER.glob("*.yaml"))


@pytest.fixture(params=CASES)
def case(request):
    return request.param, yaml.safe_load((FOLDER / f"{request.param}.yaml").read_text(encoding="utf-8"))


def test_a_mistake_is_found_at_its_place_with_its_code_and_remedy(case, tmp_path, monkeypatch):
    code, said = case
    monkeypatch.chdir(build(tmp_path, said["bad"]))
    found = load(Path(".")).diagnostics
    mine = [{"at": str(d.where), "severity": d.severity, "remedy": d.remedy} for d in found if d.code == code]
    assert mine == said["expect"] != []
    assert {d.code or d.message for d in found if d.code != code} == set(said.get("beside", ()))
    assert all(str(d).endswith(f"{advice(d.remedy)} [{d.code}]") for d in found if d.code == code)


def test_what_does_the_same_without_the_mistake_is_not_told(case, tmp_path, monkeypatch):
    monkeypatch.chdir(build(tmp_path, case[1]["good"]))
    loaded = load(Path("."))
    assert loaded.diagnostics == ()
    assert loaded.catalog is not None


def test_every_code_has_a_case():
    assert {code for code, about in CODES.items() if not about.machine} == set(CASES)


def test_the_faults_of_the_published_robot_are_known():
    """Of its configuration, and of ROS robots at large; missing-device and gpu-without-runtime are of the machine."""
    known = """duplicate-key ports-with-host-network empty-document conflict-not-declared engine-restart-policy
    missing-mount-source hidden-dependency privileged whole-dev-mounted ros2-host-net-private-ipc ros2-mixed-uid
    ros2-domain-mismatch mixed-networks hostname-with-host-network sigterm-with-cpp-node shell-without-exec
    pause-of-infrastructure pause-of-actuator-consumer duplicate-node-name missing-device unstable-device-path
    socket-file-mounted sysctls-with-host-network shm-size-with-ipc-host realtime-without-sys-nice
    gpu-without-runtime"""
    assert set(known.split()) <= set(CODES)


def test_the_shipped_manifests_have_no_finding():
    assert load(ROOT / "manifests").diagnostics == ()


def test_an_error_is_told_beside_other_errors_and_no_warning_of_a_half_read_tree(tmp_path, monkeypatch):
    """A check of the whole says nothing for sure of a tree of which a part is missing; what can never work, it can."""
    files = {
        "arm": "image: arm:1\ncontainer:\n  privileged: true\n  volumes: ['/run/rorg/rorg.sock:/run/rorg/rorg.sock']\n",
        "base": "image: base:1\nneeds: [nobody]\n",
    }
    monkeypatch.chdir(build(tmp_path, files))
    assert [d.code for d in load(Path(".")).diagnostics] == ["socket-file-mounted", ""]


def test_a_comment_lets_pass_what_it_names_and_nothing_else(tmp_path, monkeypatch):
    spec = """image: arm:1
container:
  # rorg: allow privileged: the vendor's driver opens a memory device
  # rorg: allow tty-without-stdin: it is the next line that has one
  privileged: true
  tty: true
"""
    monkeypatch.chdir(build(tmp_path, {"arm": spec}))
    assert [(str(d.where), d.code) for d in load(Path(".")).diagnostics] == [
        ("services/arm.yaml:8:5", "allow-without-effect"),
        ("services/arm.yaml:10:10", "tty-without-stdin"),
    ]


def test_what_holds_for_all_services_is_told_once_and_not_of_those_that_may(tmp_path, monkeypatch):
    spec = "image: net:1\nprofile: plain\ncontainer:\n  logging: {driver: json-file}"
    allowed = f"{spec}   # rorg: allow log-without-limits: the disk is large\n"
    monkeypatch.chdir(build(tmp_path, {"arm": allowed, "base": f"{spec}\n", "face": f"{spec}\n", "net": f"{spec}\n"}))
    (found,) = load(Path(".")).diagnostics
    assert (str(found.where), found.code) == ("services/base.yaml:8:14", "log-without-limits")
    assert found.message.endswith("; 2 more like it, the next at services/face.yaml:8:14")


def test_a_program_of_ros2_with_the_address_of_a_master_is_not_called_one_of_ros1(tmp_path, monkeypatch):
    both = "image: ros:humble\ncommand: ros2 run demo talker\ncontainer: {environment: {ROS_MASTER_URI: 'http://a:11311'}}\n"
    core = "image: ros:noetic\ncommand: roscore\nready: {tcp: 11311}\nprofile: ros1\n"
    monkeypatch.chdir(build(tmp_path, {"both": both, "roscore": core}))
    (found,) = (d for d in load(Path(".")).diagnostics if d.code == "ros1-without-roscore")
    assert found.message.startswith("'both' has the address of a ROS master, and does not need 'roscore'")
    assert found.remedy == "needs: [roscore]"


def test_data_that_a_lone_service_exchanges_with_unknown_ones_is_a_hint(tmp_path, monkeypatch):
    spec = "image: net:1\ncommand: ros2 run demo talker\ncontainer: {network_mode: host, logging: {driver: local}}\n"
    monkeypatch.chdir(build(tmp_path, {"net": spec}))
    assert [(d.code, d.severity) for d in load(Path(".")).diagnostics] == [("ros2-host-net-private-ipc", "hint")]


def test_hints_take_no_place_of_a_warning(tmp_path, monkeypatch):
    spec = "image: net:1\ncontainer: {tty: true, privileged: true}\n"
    monkeypatch.chdir(build(tmp_path, {f"s{n}": spec for n in range(MOST_TOLD)}))
    assert [d.code for d in load(Path(".")).diagnostics] == ["privileged"] * MOST_TOLD


def test_the_socket_of_the_engine_is_told_once_and_nobody_is_told_to_mount_run(tmp_path, monkeypatch):
    volumes = '["/var/run/docker.sock:/var/run/docker.sock", "/run/avahi.sock:/run/avahi.sock"]'
    monkeypatch.chdir(build(tmp_path, {"net": f"image: net:1\ncontainer:\n  volumes: {volumes}\n"}))
    found = [(d.code, d.remedy) for d in load(Path(".")).diagnostics]
    assert found == [
        ("engine-socket-mounted", "may_request or may_manage, by which rorg does it"),
        ("socket-file-mounted", "a directory of its own for the socket"),
    ]


@pytest.mark.parametrize(
    ("option", "unless"),
    [
        ("environment: {NVIDIA_VISIBLE_DEVICES: all}", "unless the engine's default runtime gives it one"),
        ("{network_mode: host, ipc: private}", "if its middleware is Fast DDS"),
        ("environment: {RMW_IMPLEMENTATION: rmw_cyclonedds_cpp}", "if your image is the same"),
        ("command: _rate:=10", "unless the program reads it itself"),
        ("logging: {}", "unless the engine's own configuration limits it"),
        ('{network_mode: host, environment: {DISPLAY: ":0"}}', "unless the X server has an abstract socket, too"),
    ],
)
def test_what_the_image_or_the_engine_may_know_is_told_with_an_if(option, unless, tmp_path, monkeypatch):
    words = option.removeprefix("command: ") if option.startswith("command: ") else ""
    options = "{}" if words else option if option.startswith("{") else f"{{{option}}}"
    spec = f"image: ros:humble\nprofile: plain\ncommand: ros2 run demo talker {words}\ncontainer: {options}\n"
    monkeypatch.chdir(build(tmp_path, {"net": spec}))
    assert [d.code for d in load(Path(".")).diagnostics if unless in d.message]


@pytest.mark.parametrize(
    ("command", "missing"),
    [
        ("sh -c 'nav --speed $(cat /f/speed)'", []),
        ("sh -c 'nav --speed \"$(cat /f/speed)\"'", []),
        ("sh -c 'nav --speed `cat /f/speed`'", []),
        ("sh -c '(cat </f/speed;cat /f/speed)|nav >/dev/null&'", []),
        ("sh -c 'cat \"/f/a (1)\" /f/*'", []),
        ("sh -c 'cat /f/s?eed /f/[a-s]peed /f/{speed,a} /f/$NAME ${FILE:-/f/x}'", []),
        ("cat /f/*", []),
        ("sh -c 'nav --speed $(cat /f/sped) < /f/in'", ["/f/in", "/f/sped"]),
        ("sh -c 'cat \"/f/a file\"'", ["/f/a file"]),
    ],
)
def test_files_are_named_by_the_words_of_a_shell(command, missing, tmp_path, monkeypatch):
    spec = f"image: nav:1\ncommand: {json.dumps(command)}\nmounts: [./f:/f]\n"
    files = {"nav": spec, "services/f/speed": "1", "services/f/a (1)": "1"}
    monkeypatch.chdir(build(tmp_path, files))
    found = [d.message for d in load(Path(".")).diagnostics if d.code == "missing-file"]
    assert [message.partition(" would be ")[0] for message in found] == missing


def test_a_process_has_the_devices_files_and_names_of_its_machine(tmp_path, monkeypatch):
    spec = """image: laser:1
command: python3 -c pass /dev/ttyUSB0
container:
  environment: {CYCLONEDDS_URI: "file:///cyclonedds.xml"}
"""
    monkeypatch.chdir(build(tmp_path, {"laser": spec}))
    found = {engine: {d.code for d in load(Path("."), engine=engine).diagnostics} for engine in ("docker", "process")}
    of_containers = {"device-not-given", "file-not-mounted"}
    assert of_containers <= found["docker"]
    assert of_containers.isdisjoint(found["process"])


def test_an_error_cannot_be_let_pass(tmp_path, monkeypatch):
    spec = "image: face:1\ncontainer:\n  # rorg: allow ports-with-host-network: why not\n  ports: ['80:80']\n"
    monkeypatch.chdir(build(tmp_path, {"face": spec}))
    assert "ports-with-host-network" in [d.code for d in load(Path(".")).errors]


def test_a_comment_in_an_overlay_is_said_of_the_overlay(tmp_path, monkeypatch):
    over = "apiVersion: rorg/v1\nkind: Service\nmetadata: {name: arm}\nspec:\n  container:\n    privileged: true"
    files = {
        "arm": "image: arm:1\n",
        "robots/lab/services/arm.yaml": f"{over}   # rorg: allow privileged: a test stand\n",
    }
    monkeypatch.chdir(build(tmp_path, files))
    assert load(Path("."), robot="lab").diagnostics == ()
    (tmp_path / "robots/lab/services/arm.yaml").write_text(over)
    assert [d.code for d in load(Path("."), robot="lab").diagnostics] == ["privileged"]


@pytest.mark.slow
@given(st.text("/.:~-_ab1 \n\"'é", max_size=60))
@settings(max_examples=300, deadline=None)
def test_names_are_found_word_by_word_as_in_the_whole_text(text):
    """Words are only a short way to what the expression finds in the whole."""
    assert texts.names_in(text) == {name for pair in texts._NAME.findall(text) for name in pair if name}
    assert texts._calls_in(text) == set(texts._CALLED.findall(text))


@pytest.mark.parametrize("word", idle.ACTUATORS.pattern.split("|"))
def test_each_word_of_an_actuator_has_a_hint(word):
    """Without one it would never be looked for."""
    plain = re.sub(r"\(\?<?!.*?\)|\\\w\+?|[()]", "", word.replace("2?", "").replace("s?", ""))
    assert any(hint in plain for hint in idle.HINTS), plain


@pytest.mark.slow
def test_checks_take_a_small_part_of_the_time_of_a_load(tmp_path):
    """An eighth, of 300 services with launch files."""
    node = '<node name="n{0}_{1}" pkg="p" type="t"><remap from="/scan" to="/front{0}/scan"/></node>\n'
    for number in range(300):
        nodes = "".join(node.format(number, n) for n in range(12))
        spec = f"image: robot:1\nprofile: ros1\ncommand: roslaunch /s/x.launch --wait\nneeds: [s{number // 2}]\n"
        spec += f"idle: {{action: pause}}\nmounts: [./{number}:/s]\n"
        files = {f"s{number + 1}": spec, f"services/{number}/x.launch": f"<launch>\n{nodes}</launch>\n"}
        build(tmp_path, files)
    build(tmp_path, {"s0": "image: ros:1\n", "roscore": "image: ros:1\ncommand: roscore\nready: {tcp: 11311}\n"})
    loaded = load(tmp_path)
    whole = least(lambda: load(tmp_path))
    part = least(lambda: validate(loaded.catalog, loaded.sources))
    assert part < 0.3 * whole


def least(do) -> float:
    """CPU seconds of this process; what others do at the time is not in the least of several."""
    found = []
    for _ in range(5):
        began = time.process_time()
        do()
        found.append(time.process_time() - began)
    return min(found)
