"""ROS 2 with real rclpy nodes on Docker: readiness by the graph, managed nodes as an idle action, parameters."""

from __future__ import annotations

import contextlib
import os
import random
import time
from collections.abc import Iterator

import pytest
from common import wait_for
from robots import Daemon, RealRobot
from rorg_client import Client
from rorg_client.errors import NotReady
from ros2_programs import Hand, Ros2

pytestmark = pytest.mark.docker
SERVER = "python3 /nodes/server.py"
MANAGED = "python3 /nodes/managed.py"
GRAPH = {"may_report_graph": True}


@pytest.fixture
def robot(dockerd, tmp_path) -> Iterator[RealRobot]:
    found = RealRobot(tmp_path, "docker", dockerd.host, with_server=True)
    yield found
    found.close()


def healthy(robot: RealRobot, service: str) -> bool:
    return robot.client().service(service)["health"] == "Healthy"


def message(robot: RealRobot, service: str) -> str:
    return robot.client().service(service)["message"]


def test_each_probe_holds_or_says_what_is_missing(robot, ros2: Ros2, tmp_path):
    there = [
        {"ros_node": "/robot/server"},
        {"ros_topic": "/robot/server/chatter"},
        {"ros_rate": {"topic": "/robot/server/chatter", "hz": 8}},
        {"ros_service": "/robot/server/list_parameters"},
        {"ros_action": "/robot/server/count"},
        {"ros_parameter": "/robot/server/speed"},
    ]
    missing = {
        "no node /nobody": {"ros_node": "/nobody"},
        "/nowhere has no publisher": {"ros_topic": "/nowhere"},
        "/robot/server/chatter has ": {"ros_rate": {"topic": "/robot/server/chatter", "hz": 100}},
        "no service /none": {"ros_service": "/none"},
        "no action server /none": {"ros_action": "/none"},
        "/robot/server/none is not set": {"ros_parameter": "/robot/server/none"},
        "node /robot/server does not answer (lifecycle)": {"lifecycle": {"node": "/robot/server"}},
    }
    server = ros2.service(f"{SERVER} server", tmp_path, ready={"all": there}, ros={"namespace": "/robot"})
    waiter = ros2.service(f"{SERVER} waiter", tmp_path, ready={"all": list(missing.values()), "timeout": "5m"})
    robot.declare({"server": server, "waiter": waiter, "graph": ros2.node(tmp_path)})
    robot.request("server", "waiter")
    robot.wait(lambda: "nothing reports the ROS 2 graph of domain" in message(robot, "server"))
    robot.declare({"server": server, "waiter": waiter, "graph": ros2.node(tmp_path, **GRAPH)})
    robot.wait(lambda: healthy(robot, "server"))
    robot.wait(lambda: all(text in message(robot, "waiter") for text in missing))
    assert not healthy(robot, "waiter")


def test_a_run_is_not_ready_by_what_an_earlier_one_left_in_the_graph(robot, ros2: Ros2, tmp_path):
    """DDS shows a killed program for its lease. Its next run has a node of the same name long before it publishes."""
    slow = ros2.service(f"{SERVER} slow 2", tmp_path, ready={"ros_topic": "/slow/chatter"})
    robot.declare({"slow": slow, "graph": ros2.node(tmp_path, **GRAPH)})
    robot.request("slow")
    robot.wait(lambda: healthy(robot, "slow"))
    for _ in range(2):
        run = robot.run_of("slow")
        robot.kill("slow")
        robot.wait(lambda run=run: "running" in robot.states()["slow"] and robot.run_of("slow") != run)
        robot.client().wait("slow", timeout=30)
        logged = b"".join(line.text for line in robot.engine.log_lines(robot.container("slow").id, 1, None, False))
        assert logged.startswith(b"publishes"), "it is ready, and has not published yet"
        began = robot.container("slow").incarnation
        assert began != run


def lifecycle(ros2: Ros2, tmp_path, names: str, failing: str = "", **more: object) -> dict:
    command = f"{MANAGED} {names} {failing}".strip()
    more = {"idle": {"action": "deactivate"}, "ros": {"lifecycle": [f"/{names}"]}, **more}
    return ros2.service(command, tmp_path, **more)


def transitions(robot: RealRobot, service: str) -> list[str]:
    """What a managed node was told, as it printed it."""
    lines = robot.engine.log_lines(robot.container(service).id, None, None, False)
    return [said for line in lines if (said := line.text.decode().strip()) in ("configure", "activate", "deactivate")]


def test_managed_nodes_are_deactivated_and_activated_again(robot, ros2: Ros2, tmp_path):
    def inactive() -> bool:
        return robot.client().service("amcl")["state"] == "inactive"

    robot.declare({"amcl": lifecycle(ros2, tmp_path, "amcl"), "graph": ros2.node(tmp_path, **GRAPH)})
    robot.request("amcl", id="one")
    robot.client().wait("amcl", timeout=60)
    run, told = robot.run_of("amcl"), ["configure", "activate"]
    assert transitions(robot, "amcl") == told
    for _ in range(3):
        robot.release("one")
        robot.wait(inactive)
        assert robot.container("amcl").state == "running", "its container and its connections stay"
        robot.request("amcl", id="one")
        robot.client().wait("amcl", timeout=10)
        told += ["deactivate", "activate"]
        assert transitions(robot, "amcl") == told
    robot.release("one")
    robot.wait(inactive)
    # Somebody activates it by hand, although nothing wants it.
    hand = Hand(ros2, tmp_path)
    assert hand.run("python3", "/nodes/lifecycle.py", "/amcl").strip() == "inactive"
    hand.run("python3", "/nodes/lifecycle.py", "/amcl", "activate")
    hand.close()
    told += ["deactivate", "activate", "deactivate"]
    robot.wait(lambda: transitions(robot, "amcl") == told)
    # A restart of the reporter, or of rorg, changes nothing.
    robot.kill("graph")
    robot.stop()
    robot.start()
    robot.wait(lambda: robot.loop.decision is not None and robot.quiet() and inactive())
    assert (robot.run_of("amcl"), transitions(robot, "amcl")) == (run, told)


def test_a_transition_that_fails_or_hangs_falls_back_to_stop(robot, ros2: Ros2, tmp_path):
    robot.declare(
        {
            "refuses": lifecycle(ros2, tmp_path, "refuses", "deactivate"),
            "sleeps": lifecycle(ros2, tmp_path, "sleeps", "hang-deactivate"),
            "idle": lifecycle(ros2, tmp_path, "idle", "configure"),
            "graph": ros2.node(tmp_path, **GRAPH),
        }
    )
    robot.request("refuses", "sleeps", "idle", id="one")
    robot.client().wait("refuses", "sleeps", timeout=60)
    robot.wait(lambda: "/idle failed to configure, and is unconfigured now" in message(robot, "idle"))
    robot.release("one")
    robot.wait(lambda: robot.states()["refuses"] == robot.states()["sleeps"] == "exited")
    said = "\n".join(robot.lines)
    assert "stop instead of deactivate: /refuses failed to deactivate, and is active now" in said
    assert "/sleeps/change_state does not answer" in said
    assert robot.states()["idle"] == "running", "it is not active anyway"


def test_parameters_are_read_at_the_start_and_set_while_it_runs(robot, ros2: Ros2, tmp_path):
    def tree(speed: float, names: list[str]) -> dict:
        ros = {"parameters": {"/server/speed": speed, "/server/frames": {"names": names}}}
        return {
            "server": ros2.service(f"{SERVER} server", tmp_path, ready={"ros_parameter": "/server/speed"}, ros=ros),
            "graph": ros2.node(tmp_path, **GRAPH),
        }

    robot.declare(tree(0.7, ["base", "arm"]))
    robot.request("server")
    robot.client().wait("server", timeout=60)
    hand, run = Hand(ros2, tmp_path), robot.run_of("server")
    try:
        assert heard(hand) == "0.7 base arm"
        robot.declare(tree(0.9, ["base"]))
        robot.wait(lambda: heard(hand) == "0.9 base")
        assert robot.run_of("server") == run, "a changed parameter needs no other run"
        assert any("2 ROS parameters of server set at domain" in line for line in robot.lines)
        robot.client().call("POST", "/v1/services/server/restart")
        robot.wait(lambda: robot.run_of("server") != run and healthy(robot, "server"))
        assert heard(hand) == "0.9 base"
        assert len(robot.containers()) == 2, "nor another container"
    finally:
        hand.close()


def heard(hand: Hand) -> str:
    """The next message of the server."""
    return hand.run("python3", "/nodes/hear.py", "/server/chatter").strip()


def test_pausing_minds_the_graph_of_ros_2(robot, ros2: Ros2, tmp_path):
    pause = {"idle": {"action": "pause", "connected": "stop"}, "labels": {"ros_nodes": "/mindful"}}
    tree = {
        "server": ros2.service(f"{SERVER} server", tmp_path, ready={"ros_node": "/server"}),
        "mindful": ros2.service("python3 /nodes/hear.py /server/chatter mindful", tmp_path, **pause),
        "careless": ros2.service(
            f"{SERVER} careless", tmp_path, ready={"ros_node": "/careless"}, idle={"action": "pause"}
        ),
        "graph": ros2.node(tmp_path, **GRAPH),
    }
    robot.declare(tree)
    robot.request("server", id="server")
    robot.request("mindful", "careless", id="both")
    robot.client().wait("server", "mindful", "careless", timeout=60)
    robot.wait(lambda: "callers hang while it is paused" in why(robot, "careless"))
    robot.wait(lambda: connected(robot, ros2))
    robot.release("both")
    robot.wait(lambda: robot.states()["careless"] == "paused" and robot.states()["mindful"] == "exited")
    # The line follows the state: it is written when the call has returned.
    told = "stop instead of pause: connected to server by /server/chatter"
    robot.wait(lambda: any(told in line for line in robot.lines))


def connected(robot: RealRobot, ros2: Ros2) -> bool:
    graph = robot.loop.decision.situation.ros.get(f"domain {ros2.domain}")
    return graph is not None and graph.subscribers.get("/server/chatter") == ("/mindful",)


def why(robot: RealRobot, service: str) -> str:
    return "; ".join(c["message"] for c in robot.client().service(service)["conditions"] if c["status"] == "False")


def test_kills_make_nothing_ready_that_is_not_and_restart_nothing_else(robot, ros2: Ros2, tmp_path):
    """One kill of each kind; more, at random, for RORG_TEST_ROS_MINUTES."""
    tree = {
        "server": ros2.service(f"{SERVER} server 1", tmp_path, ready={"ros_topic": "/server/chatter"}),
        "amcl": lifecycle(ros2, tmp_path, "amcl"),
        "graph": ros2.node(tmp_path, **GRAPH),
    }
    robot.declare(tree)
    robot.stop()
    daemon, client = Daemon(robot), robot.client()
    daemon.start()
    wait_for(daemon.status, 30, "rorg to run")
    seed = os.environ.get("RORG_TEST_SEED", "0")
    draw, kinds, kills = random.Random(seed), [*tree, "rorg"], 0
    end = time.monotonic() + 60 * float(os.environ.get("RORG_TEST_ROS_MINUTES", "0"))
    with client.request("server", "amcl", wait=60):
        runs = {name: robot.container(name).incarnation for name in ("server", "amcl")}
        while kills < len(kinds) or time.monotonic() < end:
            what = kinds[kills] if kills < len(kinds) else draw.choice(kinds)
            kills += 1
            if what == "rorg":
                daemon.kill()
                daemon.start()
            else:
                before = robot.container(what).incarnation
                robot.kill(what)
                robot.wait(lambda killed=what, run=before: robot.container(killed).incarnation != run, 90)
            robot.wait(lambda: both_ready(client))
            assert works(robot), f"ready after the kill of {what}, and not at work (RORG_TEST_SEED={seed})"
            now = {name: robot.container(name).incarnation for name in runs}
            assert all(now[name] == runs[name] for name in runs if name != what), f"restarted by the kill of {what}"
            runs = now
    daemon.stop()
    print(f"{kills} kills, seed {seed}: nothing called ready that was not, nothing restarted without need")


def both_ready(client: Client) -> bool:
    """Whether they are ready in the end. A wait for a service that was killed three times in a row is refused until its
    next run has begun."""
    with contextlib.suppress(NotReady):
        client.wait("server", "amcl", timeout=60)
        return True
    return False


def works(robot: RealRobot) -> bool:
    """Whether the present run of each program has said that it does its work."""
    said = {name: b"".join(run_log(robot, name)) for name in ("server", "amcl")}
    return b"publishes" in said["server"] and said["amcl"].rstrip().endswith(b"activate")


def run_log(robot: RealRobot, service: str) -> Iterator[bytes]:
    return (text for text, _ in robot.engine.log_since(robot.container(service).id, ""))
