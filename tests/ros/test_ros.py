"""Real ROS 1: readiness by the graph, a killed master, stale registrations."""

from __future__ import annotations

import time

import pytest
from common import free_port
from ros_master import healthy, master, services  # noqa: F401

from rorg.probes import ros_master
from rorg.probes.ros_state import read_state, refuses, unregister

pytestmark = pytest.mark.docker


def graph(master: str) -> set[str]:  # noqa: F811
    """Names of the nodes that publish something."""
    try:
        return {n for _, names in ros_master.call(master, "getSystemState", "/test")[0] for n in names}
    except OSError:
        return set()


def test_a_node_is_ready_when_it_is_in_the_graph_and_answers(docker_robot, ros_image, master):  # noqa: F811
    docker_robot.declare({**services(ros_image, master, "talker"), "behaviour": {"needs": ["talker"]}})
    docker_robot.request("behaviour")
    docker_robot.wait(lambda: "behaviour" in docker_robot.active(), 60)
    assert "/talker" in graph(master)
    assert ros_master.probe("ros_node", "/nobody", master).message == "/nobody is not registered"
    assert ros_master.probe("ros_topic", "/talker/chatter", master).ok
    assert ros_master.probe("ros_topic", "/talker/silence", master).message == "/talker/silence has no publisher"
    assert ros_master.probe("ros_service", "/talker/get_loggers", master).ok
    assert ros_master.probe("ros_service", "/talker/nothing", master).message == "/talker/nothing is not registered"
    assert "does not answer" in ros_master.probe("ros_node", "/talker", f"http://localhost:{free_port()}").message


def test_all_dependants_of_a_killed_master_are_back_in_the_graph_by_themselves(docker_robot, ros_image, master):  # noqa: F811
    names = ("talker1", "talker2", "talker3")
    docker_robot.declare(services(ros_image, master, *names))
    docker_robot.request(*names)
    docker_robot.wait(lambda: healthy(docker_robot, "roscore", *names), 60)
    before = {c.service: c.incarnation for c in docker_robot.containers()}
    docker_robot.kill("roscore")
    docker_robot.wait(lambda: all(c.incarnation != before[c.service] for c in docker_robot.containers()), 60)
    docker_robot.wait(lambda: healthy(docker_robot, "roscore", *names), 60)
    assert {f"/{n}" for n in names} <= graph(master)


def test_a_killed_node_is_purged_and_a_paused_one_never(docker_robot, ros_image, master):  # noqa: F811
    """Also one that is killed while no rorg runs."""
    tree = services(ros_image, master, "sleeper", "victim", "other")
    for name in ("victim", "other"):
        tree[name]["restart"] = "never"  # or it would register again at once
    docker_robot.declare(tree)
    for name in ("sleeper", "victim", "other"):
        docker_robot.request(name, id=name)
    docker_robot.wait(lambda: healthy(docker_robot, "sleeper", "victim", "other"), 60)
    docker_robot.release("sleeper")
    docker_robot.wait(lambda: docker_robot.states()["sleeper"] == "paused")
    docker_robot.engine.api().kill(docker_robot.container("victim").id, "SIGKILL")
    docker_robot.wait(lambda: purged(docker_robot, "victim"))
    assert graph(master) >= {"/sleeper", "/other"}
    assert "/victim" not in graph(master)
    docker_robot.stop()
    docker_robot.engine.api().kill(docker_robot.container("other").id, "SIGKILL")
    docker_robot.wait(lambda: refuses(read_state(master).places["/other"]))
    docker_robot.start()
    docker_robot.wait(lambda: purged(docker_robot, "other"))
    assert "/sleeper" in graph(master)
    assert "/other" not in graph(master)
    docker_robot.request("sleeper", id="sleeper")
    docker_robot.wait(lambda: healthy(docker_robot, "sleeper"))


def purged(robot, node: str) -> bool:
    return any(f"stale registration of the ROS node /{node} was" in line for line in robot.log())


def test_a_node_that_answers_elsewhere_by_now_is_not_purged(docker_robot, ros_image, master):  # noqa: F811
    docker_robot.declare(services(ros_image, master, "talker"))
    docker_robot.request("talker")
    docker_robot.wait(lambda: healthy(docker_robot, "talker"), 60)
    before = read_state(master)
    docker_robot.kill("talker")
    docker_robot.wait(lambda: read_state(master).places.get("/talker") not in (None, before.places["/talker"]))
    with pytest.raises(LookupError, match="at another address"):
        unregister(master, "/talker", before)
    assert "/talker" in graph(master)


def test_asking_the_graph_costs_milliseconds(docker_robot, ros_image, master):  # noqa: F811
    docker_robot.declare(services(ros_image, master, "talker"))
    docker_robot.request("talker")
    docker_robot.wait(lambda: healthy(docker_robot, "talker"), 60)
    took = []
    for _ in range(51):
        began = time.perf_counter()
        assert ros_master.probe("ros_node", "/talker", master).ok
        took.append(time.perf_counter() - began)
    assert sorted(took)[25] < 0.05
