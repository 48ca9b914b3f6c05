"""The graph of a ROS 1 master as a value: who is connected to whom, and which nodes change hands."""

from __future__ import annotations

from rorg.core.ros_graph import RosGraph, Takeover, connections, takeovers

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
