"""`rorg get` and `rorg describe` beside a running rorg: reasons where people look, from the socket alone."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import socket
import struct
import subprocess
import sys
import termios
import threading
from datetime import datetime

import commands
import pytest
import yaml
from common import wait_for
from robots import RealRobot, write_tree
from rorg_process import RorgProcess

from rorg.cli.get import age
from rorg.cli.watch import Watch

SERVICES = {
    "fine": {"always_on": True, "priority": 9},
    "quits": {"always_on": True, "command": ["sh", "-c", "echo oh no; exit 3"]},
    "deaf": {"always_on": True, "ready": {"file": "/nonexistent", "timeout": "50ms"}},
    "absent": {"always_on": True, "command": ["no-such-program"]},
    "idle": {"container": {"environment": {"TOKEN": "hunter2"}}},
}


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    found = RealRobot(tmp_path_factory.mktemp("robot"), "process", None, with_server=True)
    found.declare(
        SERVICES,
        groups={"good": {"services": ["fine", "idle"]}},
        policies={"policy": {"removals": "ask"}},
        profiles={"slow": {"idle": {"linger": "9s"}}},
    )
    path = found.tree / "services/fine.yaml"
    manifest = yaml.safe_load(path.read_text())
    manifest["metadata"]["labels"] = {"site": "lab", "arm": "left"}
    path.write_text(yaml.safe_dump(manifest))
    found.wait(lambda: "fine" in found.active() and all(text in rorg(found, "get") for text in REASONS))
    yield found
    found.close()


REASONS = ("ended with exit code 3; again in", "no program 'no-such-program'", "/nonexistent: No such file")


def rorg(robot: RealRobot, *words: str, code: int = 0) -> str:
    done = commands.rorg(*words, code=code, RORG_STATE_DIR=str(robot.state.path), RORG_ENGINE="process")
    return done.stdout + done.stderr


def names(text: str) -> list[str]:
    return [line.split()[0] for line in text.splitlines()[1:]]


def test_reasons_are_in_the_default_view(robot):
    lines = rorg(robot, "get").splitlines()
    assert lines[0].split() == ["NAME", "STATE", "SYNC", "HEALTH", "RESTARTS", "AGE", "WHY", "MESSAGE"]
    assert "no such program" not in rorg(robot, "get", "fine")
    assert "MESSAGE" not in rorg(robot, "get", "fine"), "nobody has one"
    quits = json.loads(rorg(robot, "get", "quits", "-o", "json"))[0]
    assert quits["crashes"] >= 1
    assert "ended with exit code 3" in quits["message"]
    assert quits["sync"] == "Synced", "it crashes in the container that is declared"


def test_a_name_in_place_of_a_kind(robot):
    assert names(rorg(robot, "get", "idle", "fine")) == ["fine", "idle"]
    assert names(rorg(robot, "get", "good")) == ["fine", "idle"]
    assert "'services'" in rorg(robot, "get", "servces", code=2)
    assert "'idle'" in rorg(robot, "get", "idel", code=2)


def test_a_kind_behind_a_name_is_told_its_place(robot):
    why = "cannot find the service '{0}': a kind comes before names; try `rorg {1}`"
    for kind in ("requests", "request"):
        assert why.format(kind, f"get {kind} fine") in rorg(robot, "get", "fine", kind, code=2)
    assert why.format("images", "get images idle fine") in rorg(robot, "get", "idle", "images", "fine", code=2)
    assert why.format("svc", "describe svc idle") in rorg(robot, "describe", "idle", "svc", code=2)


def test_requests_are_chosen_by_id_and_by_what_they_ask_for(robot):
    rorg(robot, "request", "idle", "--reason", "tour")
    try:
        wait_for(lambda: "tour" in rorg(robot, "get", "requests", "-o", "wide"))
        (found,) = json.loads(rorg(robot, "get", "requests", "idle", "-o", "json"))
        assert found["services"] == ["idle"]
        assert json.loads(rorg(robot, "get", "requests", found["id"], "-o", "json")) == [found]
        assert json.loads(rorg(robot, "get", "requests", "quits", "-o", "json")) == []
        assert json.loads(rorg(robot, "get", "requests", "good", "-o", "json")) == [found]
        assert "no such request; try 'idle'" in rorg(robot, "get", "requests", "idel", code=2)
    finally:
        rorg(robot, "release", "idle")


def test_services_are_chosen_by_group_and_label(robot):
    assert names(rorg(robot, "get", "--group", "good")) == ["fine", "idle"]
    assert names(rorg(robot, "get", "-l", "site=lab,arm")) == ["fine"]
    assert names(rorg(robot, "get", "-l", "site=home")) == []
    assert names(rorg(robot, "get", "--group", "good", "quits")) == []
    assert "no such group" in rorg(robot, "get", "--group", "god", code=2)
    assert "about services" in rorg(robot, "get", "groups", "-l", "site=lab", code=2)


def test_services_are_sorted(robot):
    assert names(rorg(robot, "get", "--sort-by", "priority"))[-1] == "fine"
    assert names(rorg(robot, "get", "--sort-by", "restarts"))[0] == "quits"
    assert set(names(rorg(robot, "get", "--sort-by", "age"))[:2]) == {"deaf", "fine"}
    assert "is not one of 'name', 'state', 'age'" in rorg(robot, "get", "--sort-by", "size", code=2)


def test_profiles_and_policies_are_listed(robot):
    assert rorg(robot, "get", "policies").split() == ["NAME", "FILE", "policy", "policies/policy.yaml"]
    assert [p["name"] for p in json.loads(rorg(robot, "get", "profiles", "-o", "json"))] == ["slow"]
    assert "no such profile" in rorg(robot, "get", "profile", "fast", code=2)


def test_an_age_is_as_kubectl_has_it():
    assert [age(s) for s in (-1, 5.9, 60, 3 * 60 + 50, 7300, 4 * 86400)] == ["0s", "5s", "1m", "3m", "2h", "4d"]


def test_describe_ends_with_what_happened_and_what_it_said(robot):
    found = yaml.safe_load(wait_for(lambda: (t := rorg(robot, "describe", "quits")) and "oh no" in t and t))
    assert list(found)[-2:] == ["events", "log"]
    assert found["log"][-1] == "oh no"
    assert len(found["log"]) <= 10
    assert any("exit code 3" in event for event in found["events"])
    assert "ended with exit code 3" in found["message"]
    for name, reason in (("deaf", "/nonexistent"), ("absent", "no-such-program")):
        assert reason in yaml.safe_load(rorg(robot, "describe", name))["message"]


def test_describe_in_numbers_without_secrets(robot):
    text = rorg(robot, "describe", "good", "-o", "json")
    fine, idle = json.loads(text)
    assert "hunter2" not in text
    assert "TOKEN" in idle["container"]["environment"]
    assert isinstance(fine["idle"]["linger"], float)
    assert datetime.fromisoformat(fine["status"]["started_at"]).utcoffset() is not None
    assert "no such service" in rorg(robot, "describe", "fin", code=2)


def test_describe_takes_a_kind_before_the_name_as_kubectl_does(robot):
    plain = json.loads(rorg(robot, "describe", "idle", "-o", "json"))
    for kind in ("service", "services", "svc"):
        assert json.loads(rorg(robot, "describe", kind, "idle", "-o", "json")) == plain
    assert [s["name"] for s in json.loads(rorg(robot, "describe", "group", "good", "-o", "json"))] == ["fine", "idle"]
    assert "no such service" in rorg(robot, "describe", "service", "fin", code=2)
    assert "'good': it is a group; try `rorg describe group good`" in rorg(robot, "describe", "svc", "good", code=2)
    assert "'idle': it is a service; try `rorg describe service idle`" in rorg(
        robot, "describe", "group", "idle", code=2
    )
    assert "no such kind; try 'service'" in rorg(robot, "describe", "servce", "idle", code=2)
    assert "`rorg get profiles slow -o yaml`" in rorg(robot, "describe", "profile", "slow", code=2)


def test_beside_a_running_rorg_nothing_else_is_read(robot, tmp_path):
    """As somebody of the group, who may use the socket and nothing else."""
    words = (["get"], ["get", "policies"], ["get", "good"], ["describe", "quits"], ["logs", "good", "quits", "-n", "1"])
    for line in words:
        assert commands.rorg(*line, RORG_ADDRESS=robot.socket(), HOME=str(tmp_path)).stdout


@pytest.mark.slow
def test_a_robot_whose_loop_is_gone_says_so(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    try:
        found.declare({"fine": {"always_on": True}})
        found.wait(lambda: "fine" in found.active())
        assert "no rorg runs" not in rorg(found, "get")
        found.stop()
        told = rorg(found, "get")
        assert f"no rorg runs on {found.state.path}: this is the state of the engine" in told
        assert "running" in told
    finally:
        found.close()


# -- watching --------------------------------------------------------------------------------------------------


def row(name: str, state: str, age: str = "1s") -> dict[str, str]:
    return {"name": name, "state": state, "age": age}


def test_piped_the_head_comes_once_and_then_each_row_that_changes(capsys):
    watch, columns = Watch(), ("name", "state", "age")
    for rows in (
        [row("arm", "created"), row("base", "running")],
        [row("arm", "created", "2s"), row("base", "running", "2s")],
        [row("arm", "running", "3s"), row("base", "running", "3s")],
        [row("arm", "running", "4s")],
    ):
        watch.show(rows, "table", columns, ())
    told = ["NAME  STATE    AGE", "arm   created  1s", "base  running  1s", "arm   running  3s", "base  -        -"]
    assert capsys.readouterr().out.splitlines() == told
    watch = Watch()
    for state in ("created", "running"):
        watch.show([row("arm", state), row("base", "running")], "name", columns, ())
    assert capsys.readouterr().out.split() == ["arm", "base", "arm"]


def watching(robot: RealRobot, **more) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "rorg", "get", "-w"],
        text=True,
        env={
            **{k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")},
            "RORG_STATE_DIR": str(robot.state.path),
            "TERM": "xterm",
        },
        **more,
    )


def test_a_watching_pipe_gets_a_change_and_ends_with_its_reader(robot):
    with watching(robot, stdout=subprocess.PIPE) as process:
        said: list[str] = []
        reading = threading.Thread(target=lambda: [said.append(line) for line in process.stdout], daemon=True)
        reading.start()
        wait_for(lambda: any(line.startswith("idle") for line in said), 30)
        robot.request("idle")
        try:
            wait_for(lambda: any(line.startswith("idle") and " running " in line for line in said), 30)
        finally:
            robot.release("idle")
        process.terminate()
    reading.join(30)
    assert not [line for line in said[len(SERVICES) + 1 :] if line.startswith("fine")], "it has not changed"


def test_on_a_terminal_of_few_lines_the_head_stays_on_top(robot):
    main, other = pty.openpty()
    fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", 5, 200, 0, 0))
    said = bytearray()

    def read() -> None:
        try:
            while data := os.read(main, 65536):
                said.extend(data)
        except OSError:
            pass

    process = watching(robot, stdout=other, stdin=other, start_new_session=True)
    os.close(other)
    threading.Thread(target=read, daemon=True).start()

    def frames() -> list[list[str]]:
        return [f.replace("\r", "").splitlines() for f in said.decode().split("\x1b[J")]

    try:
        wait_for(lambda: any("more lines" in line for line in frames()[0]), 30)
        robot.request("idle")
        wait_for(lambda: len(frames()) > 1 and any("more lines" in line for line in frames()[1]), 30)
    finally:
        robot.release("idle")
        process.terminate()
        process.wait(30)
        os.close(main)
    for frame in frames()[:2]:
        lines = [line for line in frame if line.strip("\x1b[0123456789AmJ")]
        assert len(lines) == 4
        assert "NAME" in lines[0]


@pytest.mark.slow
def test_without_any_good_manifests_none_are_said_to_be_in_force(tmp_path):
    robot = RorgProcess(tmp_path, {"lamp": {"always_on": True}})
    path = robot.tree / "services/lamp.yaml"
    good = path.read_text()
    path.write_text(good.replace("image:", "imag:"))
    try:
        robot.start()
        wait_for(lambda: robot.client(patience=60).status()["tree"]["errors"])
        said = commands.rorg("get", RORG_STATE_DIR=str(robot.state)).stderr
        assert "last good" not in said
        assert "none are in force" in said
        path.write_text(good)
        wait_for(lambda: not robot.client().status()["tree"]["errors"])
        path.write_text(good.replace("image:", "imag:"))
        wait_for(lambda: robot.client().status()["tree"]["errors"])
        assert "the last good ones are in force" in commands.rorg("get", RORG_STATE_DIR=str(robot.state)).stderr
    finally:
        robot.close()


def test_what_reads_answers_beside_an_apply_where_a_killed_rorg_left_its_socket(tmp_path):
    found = RealRobot(tmp_path, "process", None)
    write_tree(found.tree, {"fine": {}})
    (tmp_path / "manifests").symlink_to(found.tree)
    found.state.run.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX) as left:  # bound, and nobody listens
        left.bind(found.socket())
    found.state.acquire("rorg apply")
    try:
        environment = {"RORG_STATE_DIR": str(found.state.path), "RORG_ENGINE": "process"}
        assert (
            "fine has no container, and is not wanted"
            in commands.rorg("why", "fine", cwd=tmp_path, **environment).stdout
        )
    finally:
        found.state.release()
        found.close()
