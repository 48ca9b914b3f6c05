"""What every container gets is a profile that people see and can leave; it overrides no image's word."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
import yaml
from common import BASE_IMAGE
from option_spellings import Shell

TELLS = """import signal, sys, time
def ends(number, frame):
    print("ends by", signal.Signals(number).name, flush=True)
    sys.exit(0)
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1): signal.signal(number, ends)
print("up", flush=True)
while True: signal.pause()"""


@pytest.fixture
def image(dockerd) -> str:
    """An image with a STOPSIGNAL of its own."""
    import docker

    api = docker.APIClient(dockerd.host, version="auto")
    list(api.build(fileobj=io.BytesIO(f"FROM {BASE_IMAGE}\nSTOPSIGNAL SIGUSR1\n".encode()), tag="stops-by-usr1"))
    return "stops-by-usr1"


def test_an_image_keeps_its_stop_signal_unless_another_is_asked_for(docker_robot, image):
    robot = docker_robot
    own = {"image": image, "command": ["python3", "-S", "-c", TELLS], "ready": {"log": "up"}}
    quiet = {
        "SIGUSR1": own,
        "SIGINT": {**own, "container": {"stop_signal": "SIGINT"}},
        "SIGTERM": {**own, "profile": "gentle"},
        "plain": {**own, "profile": "plain"},
        "without": {**own, "image": BASE_IMAGE},
    }
    quiet = {name.lower(): spec for name, spec in quiet.items()}
    gentle = {"extends": ["ros2"], "container": {"stop_signal": "SIGTERM"}}
    robot.declare(quiet, profiles={"gentle": gentle})
    robot.request(*quiet)
    robot.wait(
        lambda: (
            robot.active() == set(quiet)
            and all(
                b"up" in b"".join(line.text for line in robot.engine.log_lines(c.id, None, None, False))
                for c in robot.containers()
            )
        )
    )
    robot.release()
    robot.wait(lambda: set(robot.states().values()) == {"exited"})
    said = {
        c.service: b"".join(line.text for line in robot.engine.log_lines(c.id, None, None, False)).split()[-1].decode()
        for c in robot.containers()
    }
    assert said == {
        "sigusr1": "SIGUSR1",
        "sigint": "SIGINT",
        "sigterm": "SIGTERM",
        "plain": "SIGUSR1",
        "without": "SIGINT",
    }
    inspect = robot.engine.api().inspect_container
    assert {c.service: inspect(c.id)["Config"]["StopSignal"] for c in robot.containers()} == said


def test_profile_plain_leaves_what_every_container_gets(docker_robot):
    robot = docker_robot
    robot.declare(
        {
            "usual": {"always_on": True},
            "bare": {"always_on": True, "profile": "plain"},
            "own": {"always_on": True, "profile": "lonely"},
        },
        profiles={"lonely": {"extends": ["plain"], "container": {"environment": {"A": "1"}}}},
    )
    robot.wait(lambda: robot.active() == {"usual", "bare", "own"})
    seen = {c.service: robot.engine.api().inspect_container(c.id) for c in robot.containers()}
    hosts = {name: s["HostConfig"] for name, s in seen.items()}
    assert {n: (h["NetworkMode"], h.get("Init"), h["LogConfig"]["Config"]) for n, h in hosts.items()} == {
        "usual": ("host", True, {"max-size": "10m", "max-file": "3"}),
        "bare": ("default", None, {}),
        "own": ("default", None, {}),
    }
    names = {n: {v.partition("=")[0] for v in s["Config"]["Env"] or ()} - {"PATH"} for n, s in seen.items()}
    assert names == {
        "usual": {"TINI_KILL_PROCESS_GROUP", "PYTHONUNBUFFERED", "RORG_SERVICE"},
        "bare": set(),
        "own": {"A"},
    }


@pytest.mark.slow
def test_describe_says_which_profile_declares_an_option(tmp_path):
    shell = Shell(tmp_path)
    shell.env["RORG_ENGINE"] = "process"
    shell.service("arm", "cap_add: [KILL], environment: {ROS_DOMAIN_ID: 7}, stop_signal: INT", "profile: ros2")
    shell("validate", str(shell.tree))
    told = yaml.safe_load(shell("describe", "arm", cwd=shell.tree).stdout)["sources"]
    expected = {
        "profile common, <built in>/common.yaml": ("network_mode", "init", "logging.driver"),
        "profile ros2, <built in>/ros2.yaml": ("ipc", "environment.RMW_IMPLEMENTATION"),
        "manifest, services/arm.yaml:": ("environment.ROS_DOMAIN_ID", "stop_signal"),
    }
    for origin, options in expected.items():
        assert all(told[f"container.{option}"].startswith(origin) for option in options), told


@pytest.mark.parametrize(
    ("text", "place", "says"),
    [
        ("ports: ['80:80']", (8, 22), "ports has no effect under network_mode: host, which profile common (built in)"),
        (
            "sysctls: {net.core.somaxconn: 5}",
            (8, 45),
            "'net.core.somaxconn' belongs to the host under network_mode: host",
        ),
        ("links: [arm]", (8, 22), "links has no effect under network_mode: host"),
    ],
)
def test_what_the_common_profile_does_not_allow_is_told(tmp_path, text, place, says):
    shell = Shell(tmp_path)
    shell.service("arm", text, "restart: always")
    assert f"arm.yaml:{place[0]}:{place[1]}: error: {says}" in shell("validate", str(shell.tree), code=2).stderr


def test_networks_take_the_place_of_an_inherited_host_network(docker_robot):
    robot = docker_robot
    api = robot.engine.api()
    made = [
        api.create_network(name, driver="bridge", options={"com.docker.network.bridge.name": f"br{name}"})["Id"]
        for name in ("floor", "lab")
    ]
    try:
        robot.declare(
            {
                "arm": {
                    "container": {
                        "networks": {"lab": {"aliases": ["gripper"]}, "floor": None},
                        "ports": ["8090-8099:80"],
                    }
                },
                "log": {"container": {"logging": {"driver": "none"}, "volumes": ["/tmp:/x"]}, "profile": "low"},
            },
            profiles={"low": {"container": {"volumes": ["/var:/x", "/var:/y"]}}},
        )
        robot.wait(lambda: len(robot.containers()) == 2)
        seen = {c.service: api.inspect_container(c.id) for c in robot.containers()}
        networks = seen["arm"]["NetworkSettings"]["Networks"]
        assert sorted(networks) == ["floor", "lab"]
        assert "gripper" in networks["lab"]["Aliases"]
        assert seen["arm"]["HostConfig"]["PortBindings"] == {"80/tcp": [{"HostIp": "", "HostPort": "8090-8099"}]}
        assert sorted(seen["log"]["HostConfig"]["Binds"]) == ["/tmp:/x", "/var:/y"]
    finally:
        for container in robot.containers():
            api.remove_container(container.id, v=True, force=True)
        for network in made:
            api.remove_network(network)


def test_no_container_gains_privileges_or_processes_without_end_unless_it_says_so(docker_robot):
    robot = docker_robot
    free = {"security_opt": ["no-new-privileges:false"], "pids_limit": -1}
    robot.declare(
        {
            "usual": {"always_on": True, "container": {"security_opt": ["seccomp=unconfined"]}},
            "again": {"always_on": True, "container": {"security_opt": ["no-new-privileges"], "pids_limit": 50}},
            "sudo": {"always_on": True, "container": free},
            "heir": {"always_on": True, "profile": "lab"},
            "bare": {"always_on": True, "profile": "plain"},
        },
        profiles={"lab": {"container": free}},
    )
    robot.wait(lambda: robot.active() == {"usual", "again", "sudo", "heir", "bare"})
    seen = {c.service: robot.engine.api().inspect_container(c.id) for c in robot.containers()}
    told = {name: (s["HostConfig"]["SecurityOpt"], s["HostConfig"]["PidsLimit"]) for name, s in seen.items()}
    assert told == {
        "usual": (["no-new-privileges:true", "seccomp=unconfined"], 4096),
        "again": (["no-new-privileges"], 50),
        "sudo": (["no-new-privileges:false"], None),
        "heir": (["no-new-privileges:false"], None),
        "bare": (None, None),
    }
    status = {name: Path(f"/proc/{s['State']['Pid']}/status").read_text() for name, s in seen.items()}
    gains = {name for name, text in status.items() if "NoNewPrivs:\t0" in text}
    assert gains == {"sudo", "heir", "bare"}, "what the kernel says"
