"""`rorg validate --machine`: facts of a machine are gathered once, as a value, and a robot is checked against it."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest
from finding_cases import build

from rorg.engines.facts import engine_facts
from rorg.host.machine import gather, node, sysctl
from rorg.manifest.load import load
from rorg.manifest.validation.codes import CODES
from rorg.manifest.validation.machine import check_machine
from rorg.model.diagnostics import Diagnostic
from rorg.model.machine import Machine, Node

LASER = "/dev/serial/by-id/usb-SICK"
DRIVER = f"image: laser:1\ndriver:\n  devices: [{LASER}]\n  groups: [dialout]\ncontainer: {{user: '1000'}}\n"
LOGS = "image: bag:1\ncontainer:\n  user: '1000'\n  volumes: ['/data/logs:/logs']\n"
WEB = "image: web:1\ncontainer:\n  network_mode: bridge\n  ports: ['8080:80', '9090:90/udp']\n"
GPU = "image: net:1\ncontainer: {gpus: all}\n"
KATA = "image: net:1\ncontainer: {runtime: kata}\n"
CGROUP = "image: net:1\ncontainer: {mem_swappiness: 10}\n"
NOFILE = "image: net:1\ncontainer:\n  ulimits: {nofile: 4000000}\n"
REALTIME = "image: base:1\ncontainer:\n  cap_add: [SYS_NICE]\n  ulimits: {rtprio: 99}\n"
CPUS = "image: net:1\ncontainer:\n  cpus: 8\n  mem_limit: 1Gi\n"
ALWAYS = "image: net:1\nalways_on: true\nresources: {cpu: 8, memory: 1Gi}\n"
ROS2 = "image: talker:1\ncommand: ros2 run demo talker\nprofile: ros2\n"
THERE = Node("device", 0o660, 0, 20, "dialout")

PAUSING = "image: x\nidle: {action: pause}\n"
CASES = [
    ("engine-lacks", CGROUP, {"cgroup": 1, "lacking": {"mem_swappiness": "no"}}, "6:31", "another engine, or drop it"),
    ("engine-lacks", PAUSING, {"pauses": False}, "6:18", "another engine, or drop it"),
    ("missing-device", DRIVER, {"nodes": {LASER: Node("absent", near=f"{LASER}-if00")}}, "7:15", f"{LASER}-if00"),
    ("missing-device", DRIVER, {"nodes": {LASER: Node("file")}}, "7:15", CODES["missing-device"].remedy),
    (
        "device-of-other-group",
        DRIVER,
        {"nodes": {LASER: Node("device", 0o660, 0, 986, "uucp")}},
        "7:15",
        'driver: {groups: ["986"]}',
    ),
    ("missing-host-path", LOGS, {"nodes": {"/data/logs": Node("absent", near="/data/log")}}, "8:15", "/data/log"),
    (
        "mount-not-writable",
        LOGS,
        {"nodes": {"/data/logs": Node("directory", 0o755, 0, 0)}},
        "8:15",
        "chown 1000 /data/logs, or :ro",
    ),
    ("port-in-use", WEB, {"ports": {8080: "nginx"}}, "8:13", "another port, or end that program"),
    ("gpu-without-runtime", GPU, {"runtimes": frozenset({"runc"})}, "6:21", "the NVIDIA container toolkit"),
    ("missing-runtime", KATA, {"runtimes": frozenset({"runc"})}, "6:24", "to install it, or use another runtime"),
    ("cgroup-version", CGROUP, {"cgroup": 2}, "6:31", "to drop it"),
    (
        "limit-above-kernel",
        NOFILE,
        {"sysctls": {"fs.nr_open": 1048576}},
        "7:23",
        "a smaller limit, or a higher one for the engine",
    ),
    (
        "realtime-throttled",
        REALTIME,
        {"sysctls": {"kernel.sched_rt_runtime_us": 0}},
        "8:23",
        "kernel.sched_rt_runtime_us as the kernel has it: 950000",
    ),
    ("shm-nearly-full", ROS2, {"shm": 1 << 20}, "7:12", CODES["shm-nearly-full"].remedy),
    ("more-than-machine", CPUS, {"cpus": 4}, "7:11", "less of it"),
    ("more-than-machine", ALWAYS, {"cpus": 4}, "7:14", "fewer services that are always on"),
]
GOOD = [
    (DRIVER, {"nodes": {LASER: THERE}}),
    (DRIVER, {"nodes": {LASER: Node("device", 0o666, 0, 986)}}),
    (LOGS, {"nodes": {"/data/logs": Node("directory", 0o755, 1000, 1000)}}),
    (LOGS, {"nodes": {"/data/logs": Node("directory", 0o777, 0, 0)}}),
    (WEB, {"ports": {80: "nginx", 9090: "udp is another matter"}}),
    (GPU, {"runtimes": frozenset({"runc", "nvidia"})}),
    (GPU, {"runtimes": None}),
    (KATA, {"runtimes": frozenset({"kata"})}),
    (CGROUP, {"cgroup": 1}),
    (NOFILE, {"sysctls": {"fs.nr_open": 1 << 30}}),
    (REALTIME, {"sysctls": {"kernel.sched_rt_runtime_us": 950000}}),
    (ROS2, {"shm": 1 << 30}),
    (ROS2 + "container: {environment: {RMW_IMPLEMENTATION: rmw_zenoh_cpp}}\n", {"shm": 1 << 20}),
    (CPUS, {"cpus": 8}),
    (ALWAYS, {"cpus": 8}),
]


def found(folder: Path, spec: str, facts: dict) -> list[Diagnostic]:
    loaded = load(build(folder, {"one": spec}))
    assert loaded.catalog is not None
    assert loaded.sources is not None
    machine = Machine(**{"cpus": 64, "memory": 1 << 40, **facts})
    return check_machine(loaded.catalog, loaded.sources, machine)


@pytest.mark.parametrize(("code", "spec", "facts", "place", "remedy"), CASES)
def test_what_this_machine_does_not_have_is_found(code, spec, facts, place, remedy, tmp_path):
    (one,) = found(tmp_path, spec, facts)
    assert (one.code, one.severity, one.remedy) == (code, "warning", remedy)
    assert str(one.where) == f"{tmp_path}/services/one.yaml:{place}"


@pytest.mark.parametrize(("spec", "facts"), GOOD)
def test_what_this_machine_has_is_not_told(spec, facts, tmp_path):
    assert found(tmp_path, spec, facts) == []


def test_every_code_of_the_machine_has_a_case():
    assert {code for code, about in CODES.items() if about.machine} == {case[0] for case in CASES}


def test_a_comment_about_the_machine_is_idle_without_a_look_at_it(tmp_path):
    """Nobody knows then whether it lets something pass."""
    spec = DRIVER.replace("  devices", "  # rorg: allow missing-device: it is plugged in later\n  devices")
    assert found(tmp_path, spec, {"nodes": {LASER: Node("absent")}}) == []
    assert load(tmp_path).diagnostics == ()
    assert [d.code for d in found(tmp_path, spec, {"nodes": {LASER: THERE}})] == ["allow-without-effect"]


# -- facts -----------------------------------------------------------------------------------------------------


def test_what_is_at_a_path_is_known_with_what_is_alike(tmp_path):
    (tmp_path / "dev").mkdir()
    (tmp_path / "data").mkdir(mode=0o750)
    (tmp_path / "dev/cameras").write_text("")
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "dev/one.sock"))
    try:
        machine = gather(["/dev/camera", "/dev/cameras", "/dev/one.sock", "/data", "/nowhere/at/all"], tmp_path)
    finally:
        listener.close()
    kinds = {path: found.kind for path, found in machine.nodes.items()}
    assert kinds == {
        "/data": "directory",
        "/dev/camera": "absent",
        "/dev/cameras": "file",
        "/dev/one.sock": "socket",
        "/nowhere/at/all": "absent",
    }
    assert machine.nodes["/dev/camera"].near == "/dev/cameras"
    assert machine.nodes["/nowhere/at/all"].near == ""
    assert machine.nodes["/data"].mode == 0o750
    assert machine.nodes["/data"].uid == os.getuid()


def test_a_device_is_one_also_behind_a_link(tmp_path):
    (tmp_path / "by-id").symlink_to("/dev/null")
    assert node(tmp_path / "by-id", "/dev/by-id").kind == "device"


def test_facts_of_the_kernel_are_its_own(tmp_path):
    (tmp_path / "proc/sys/fs").mkdir(parents=True)
    (tmp_path / "proc/sys/fs/nr_open").write_text("1234\n")
    (tmp_path / "sys/fs/cgroup").mkdir(parents=True)
    assert gather([], tmp_path).sysctls == {"fs.nr_open": 1234}
    assert gather([], tmp_path).cgroup == 1
    (tmp_path / "sys/fs/cgroup/cgroup.controllers").write_text("cpu memory\n")
    assert gather([], tmp_path).cgroup == 2
    assert sysctl("fs.no_such_number") is None
    assert gather([], tmp_path).shm is None
    (tmp_path / "dev/shm").mkdir(parents=True)
    assert (gather([], tmp_path).shm or 0) > 0


def test_a_port_that_somebody_listens_at_is_in_use():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        assert listener.getsockname()[1] in gather([]).ports


def test_an_engine_that_does_not_answer_is_told_and_no_more(tmp_path):
    facts = engine_facts(f"unix://{tmp_path}/nobody.sock")
    assert facts.error == "its socket is missing"
    assert facts.runtimes == frozenset()
