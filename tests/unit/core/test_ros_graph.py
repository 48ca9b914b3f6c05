"""The graph of a ROS 1 master as a value: who is connected to whom, and which nodes change hands."""

from __future__ import annotations

from dataclasses import replace

from rorg.core.conditions import CAUTIONS
from rorg.core.ros_graph import RosGraph, Takeover, connections, takeovers
from rorg.core.status import Statuses
from rorg.model.catalog import EMPTY, Catalog, Idle, Request, Service
from rorg.tools.sim.robot import SimRobot

GRAPH = RosGraph(
    nodes={"/laser": "laser", "/slam": "slam", "/viewer": "", "/rosout": "roscore", "/slam_tf": "slam"},
    publishers={
        "/scan": ("/laser",),
        "/map": ("/slam",),
        "/rosout": ("/laser", "/slam", "/viewer"),
        "/tf": ("/slam", "/slam_tf"),
        "/echo": ("/gone",),
    },
    subscribers={"/scan": ("/slam", "/viewer"), "/map": ("/viewer",), "/rosout": ("/rosout",), "/tf": ("/slam",)},
)


def told(service: str) -> list[tuple[str, bool]]:
    return [(str(c), c.subscribes) for c in connections(GRAPH, service)]


def test_connections_are_those_with_nodes_of_others():
    assert told("slam") == [
        ("connected to the node /viewer by /map", False),
        ("connected to laser by /scan", True),
    ]
    assert told("laser") == [("connected to slam by /scan", False), ("connected to the node /viewer by /scan", False)]
    assert told("roscore") == [], "all nodes are connected to it by /rosout"
    assert told("nobody") == []


def test_a_node_that_two_services_run_is_told_while_both_are_active():
    both = {"slam", "amcl"}
    found = takeovers((), {"/map_server": "slam"}, {"/map_server": "amcl"}, both)
    assert found == (Takeover("/map_server", "slam", "amcl"),)
    assert str(found[0]) == "the ROS node /map_server of slam is registered by amcl now"
    assert takeovers(found, {"/map_server": "amcl"}, {"/map_server": "amcl"}, both) == found
    assert takeovers(found, {"/map_server": "amcl"}, {"/map_server": "slam"}, both) == found, "back again: the same"
    assert takeovers(found, {"/map_server": "amcl"}, {"/map_server": "amcl"}, {"amcl"}) == ()


def test_a_node_that_its_service_has_left_is_free():
    assert takeovers((), {"/map_server": "slam"}, {"/map_server": "amcl"}, {"amcl"}) == ()
    assert takeovers((), {}, {"/map_server": "amcl"}, {"amcl", "slam"}) == ()
    assert takeovers((), {"/map_server": "slam"}, {"/map_server": ""}, {"slam"}) == (), "a program of nobody known"


MASTER = "http://localhost:11311"


def robot_of(**services: Service) -> SimRobot:
    """In virtual time, with the services' nodes in the graph above."""
    spec = {"image": "x", "environment": {"ROS_MASTER_URI": MASTER}}
    named = {name: replace(service, name=name, spec=spec) for name, service in services.items()}
    found = SimRobot(Catalog(services={**EMPTY.services, **named}))
    found.ros = {MASTER: GRAPH}
    return found


def cautions(robot: SimRobot, service: str) -> list[tuple[str, str]]:
    decision = robot.settle()
    found = Statuses(decision.situation, decision.plan, {})[service].conditions
    return [(c.type, c.reason) for c in found if c.type in CAUTIONS]


PAUSED = Idle(action="pause")


def test_pausing_a_subscriber_is_told_while_others_want_its_publisher():
    robot = robot_of(laser=Service("", always_on=True), slam=Service("", idle=PAUSED))
    assert cautions(robot, "slam") == [("Pausable", "PublisherBlocks")]
    assert cautions(robot, "laser") == []
    robot = robot_of(laser=Service(""), slam=Service("", idle=PAUSED))
    assert cautions(robot, "slam") == [("Pausable", "LatchedTopicMissed")], "nobody wants the laser"
    needed = Service("", idle=PAUSED, needs=("laser",))
    robot = robot_of(laser=Service(""), slam=needed)
    ask = Request("test", "developer", ("slam",))
    robot.document = replace(robot.document, requests=(ask,))
    assert cautions(robot, "slam") == [("Pausable", "LatchedTopicMissed")], "nobody else wants the laser"
    robot.document = replace(robot.document, requests=(ask, Request("look", "developer", ("laser",))))
    assert cautions(robot, "slam") == [("Pausable", "PublisherBlocks")]


def test_what_is_never_paused_or_only_while_nobody_is_connected_gets_no_warning_of_that():
    laser = Service("", always_on=True)
    assert cautions(robot_of(laser=laser, slam=Service("")), "slam") == []
    assert cautions(robot_of(laser=laser, slam=Service("", always_on=True, idle=PAUSED)), "slam") == []
    stopped = Service("", idle=Idle(action="pause", connected="stop"))
    robot = robot_of(laser=laser, slam=stopped)
    assert cautions(robot, "slam") == []
    robot.ros = {MASTER: replace(GRAPH, providers={"/slam/clear": ("/slam",), "/slam/get_loggers": ("/slam",)})}
    assert cautions(robot, "slam") == [("Pausable", "CallersHang")]
    robot.ros = {MASTER: replace(GRAPH, providers={"/slam/get_loggers": ("/slam",)})}
    assert cautions(robot, "slam") == []


def test_a_paused_service_is_stopped_when_somebody_connected_is_wanted():
    robot = robot_of(laser=Service(""), slam=Service("", idle=Idle(action="pause", connected="stop")))
    everything = replace(GRAPH, subscribers={"/scan": ("/slam",)})
    robot.ros = {MASTER: everything}
    robot.document = replace(robot.document, requests=(Request("test", "developer", ("slam",)),))
    robot.settle()
    robot.document = replace(robot.document, requests=())
    robot.settle()
    assert robot.states()["slam"] == "paused", "nobody wants the laser"
    robot.ros = {}
    robot.settle()
    assert robot.states()["slam"] == "paused", "the master does not answer now"
    robot.ros = {MASTER: everything}
    robot.document = replace(robot.document, requests=(Request("look", "developer", ("laser",)),))
    robot.settle()
    assert robot.states()["slam"] == "exited"


def test_a_node_that_changed_hands_is_a_condition_of_both():
    robot = robot_of(laser=Service(""), slam=Service(""))
    robot.ros = {MASTER: replace(GRAPH, takeovers=(Takeover("/map", "slam", "laser"),))}
    assert cautions(robot, "slam") == cautions(robot, "laser") == [("NodesUnique", "TakenOver")]
