"""Restarts and holds by hand: who is affected is named, and nothing is done before somebody has agreed."""

from __future__ import annotations

import json

import pytest
from cli_shell import Shell, shell  # noqa: F401  (a fixture)
from common import wait_for
from robots import VirtualRobot, write_tree

from rorg.core.affected import Affected, by_hold, by_release, by_restart

ROBOT = {
    "core": {},
    "arm": {"needs": [{"service": "core", "restart": True}], "driver": {}},
    "camera": {"needs": ["core"]},
    "grasp": {"needs": [{"service": "arm", "restart": True}]},
    "idle": {"needs": [{"service": "core", "restart": True}], "driver": {}},
    "laser": {"driver": {}},
    "tour": {"may_request": ["laser"]},
}


@pytest.fixture
def robot(tmp_path):
    robot = VirtualRobot(tmp_path)
    robot.declare(ROBOT)
    robot.request("camera", "grasp", "tour")
    robot.wait(lambda: {"camera", "grasp", "tour"} <= robot.active())
    robot.settle()
    return robot


def affected(robot, by, *names: str) -> Affected:
    decision = robot.sim.step()
    return by(decision.situation, decision.memory, names)


def test_what_is_restarted_with_it_goes_along_all_the_way_and_what_does_not_run_does_not(robot):
    assert affected(robot, by_restart, "core") == Affected((), {"arm": True, "grasp": False})
    assert affected(robot, by_restart, "core", "arm") == Affected(("arm",), {"grasp": False})
    assert affected(robot, by_restart, "grasp") == Affected()
    assert affected(robot, by_restart, "idle") == Affected(), "it is not active, and nothing goes along"


def test_a_hold_stops_all_that_needs_it(robot):
    assert affected(robot, by_hold, "core") == Affected((), {"arm": True, "camera": False, "grasp": False})
    assert affected(robot, by_hold, "arm") == Affected(("arm",), {"grasp": False})
    assert affected(robot, by_hold, "camera") == Affected()
    assert affected(robot, by_hold, "laser") == Affected()


def test_a_driver_that_one_alone_requests_goes_with_it(robot):
    robot.request("laser", id="look", by="tour")
    robot.wait(lambda: "laser" in robot.active())
    assert affected(robot, by_restart, "tour") == Affected((), {"laser": True})
    assert affected(robot, by_hold, "tour") == Affected((), {"laser": True})
    robot.request("laser", id="too")
    assert affected(robot, by_restart, "tour") == Affected()
    assert affected(robot, by_hold, "tour") == Affected()


def released(robot, id: str, by: str = "developer") -> Affected:
    decision = robot.sim.step()
    return by_release(decision.situation, decision.memory, (by, id))


def test_a_release_stops_drivers_that_nobody_else_asks_for(robot):
    assert released(robot, "test") == Affected(), "it names grasp, and the arm ceases with that as it is declared to"
    robot.request("arm", id="mine")
    robot.settle()
    assert released(robot, "test") == Affected(), "somebody else asks for the arm"
    assert released(robot, "mine") == Affected(), "and grasp needs it"
    robot.release()
    robot.settle()
    assert released(robot, "mine") == Affected(("arm",))
    assert released(robot, "nosuch") == Affected()


def test_a_release_names_the_service_that_asked(robot):
    robot.request("laser", "camera", id="look", by="tour")
    robot.wait(lambda: "laser" in robot.active())
    robot.settle()
    assert released(robot, "look", "tour") == Affected(("laser",), {}, ("tour",))
    assert str(released(robot, "look", "tour")) == "laser moves hardware; tour asked for it, and would go on without"
    robot.request("laser", id="too")
    robot.settle()
    assert released(robot, "look", "tour") == Affected(), "nothing is taken from it"


def test_a_paused_driver_that_nobody_wants_is_not_touched_by_a_hold(tmp_path):
    robot = VirtualRobot(tmp_path)
    robot.declare({"arm": {"driver": {}, "idle": {"action": "pause"}}})
    robot.request("arm")
    robot.wait(lambda: robot.active() == {"arm"})
    assert affected(robot, by_hold, "arm").names == ("arm",)
    robot.release()
    robot.wait(lambda: robot.states() == {"arm": "paused"})
    assert affected(robot, by_hold, "arm").names == ()


def test_a_standing_request_outlives_a_restart_of_its_requester(tmp_path):
    robot = VirtualRobot(tmp_path)
    standing = {"look": {"requester": "tour", "services": ["laser"]}}
    robot.declare({"tour": {"always_on": True}, "laser": {"driver": {}}}, requests=standing)
    robot.wait(lambda: robot.active() == {"tour", "laser"})
    robot.settle()
    assert affected(robot, by_restart, "tour") == Affected()
    assert affected(robot, by_hold, "tour") == Affected((), {"laser": True})
    decision = robot.sim.step()
    assert by_release(decision.situation, decision.memory, ("tour", "look")) == Affected(), (
        "its manifest makes it again"
    )


def test_a_driver_that_is_about_to_run_is_affected(tmp_path):
    robot = VirtualRobot(tmp_path)
    robot.declare({"core": {"ready": {"delay": "1h"}}, "arm": {"needs": ["core"], "driver": {}}})
    robot.request("arm")
    robot.wait(lambda: robot.active() == {"core"})
    assert affected(robot, by_hold, "core") == Affected((), {"arm": True})
    assert affected(robot, by_hold, "arm") == Affected(("arm",))


def test_whoever_is_affected_is_named():
    found = Affected(("arm", "base"), {"camera": False, "laser": True})
    assert str(found) == "arm, base move hardware; camera, laser (moves hardware) go along"
    assert str(Affected(("arm",))) == "arm moves hardware"
    assert str(Affected((), {"camera": False})) == "camera goes along"


SHOP = {
    "core": {},
    "base": {"needs": [{"service": "core", "restart": True}], "driver": {}, "always_on": True},
}


def run_of(shell, name: str) -> str:  # noqa: F811
    return json.loads(shell("get", "services", name, "-o", "json").stdout)[0]["incarnation"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "verb", [("restart", "core"), ("hold", "core", "--for", "10m"), ("hold", "base", "--for", "9m")]
)
def test_without_a_terminal_and_without_yes_nothing_that_moves_hardware_is_touched(shell, verb):  # noqa: F811
    write_tree(shell.tree, SHOP)
    shell.run()
    before = run_of(shell, "base")
    refused = shell(*verb, code=5).stderr
    assert "base" in refused
    assert "moves hardware" in refused
    assert "--yes" in refused
    assert run_of(shell, "base") == before
    assert not (shell.state / "requests.yaml").exists(), "nothing was asked for"
    shell(*verb, "--yes")
    wait_for(lambda: run_of(shell, "base") != before)


@pytest.mark.slow
def test_where_no_rorg_runs_it_is_asked_for_too(shell):  # noqa: F811
    write_tree(shell.tree, SHOP)
    shell("apply", str(shell.tree), "--yes", "--wait")
    for verb in (("restart", "core"), ("hold", "core", "--for", "10m")):
        assert "base (moves hardware) goes along" in shell(*verb, code=5).stderr
        shell(*verb, "--yes")
    shell("hold", "core", "--end")


@pytest.mark.slow
def test_the_api_names_who_is_affected_and_does_it_when_told_again(shell):  # noqa: F811
    from rorg_client import Client, Refused

    write_tree(shell.tree, SHOP)
    shell.run()
    client = Client(str(shell.state / "run/rorg.sock"))
    for ask in (lambda **force: client.restart("core", **force), lambda **force: client.hold("core", 60, **force)):
        with pytest.raises(Refused) as refused:
            ask()
        assert list(refused.value.confirm) == ["base"]
        ask(force=True)
    client.unhold("core")


@pytest.mark.slow
def test_a_release_by_hand_asks_before_a_driver_stops(shell):  # noqa: F811
    from rorg_client import Client, Refused

    write_tree(shell.tree, {"base": {"always_on": True}, "arm": {"driver": {}}, "camera": {}})
    shell.run()
    shell("request", "arm", "--wait")
    shell("request", "camera", "--wait")
    shell("release", "camera")
    for line in (("release", "arm"), ("stop", "arm")):
        refused = shell(*line, code=5).stderr
        assert "arm moves hardware" in refused
        assert "--yes" in refused
    with pytest.raises(Refused) as asked:
        Client(str(shell.state / "run/rorg.sock")).call("DELETE", "/v1/requests/arm?force=false")
    assert list(asked.value.confirm) == ["arm"]
    assert [r["id"] for r in json.loads(shell("get", "requests", "-o", "json").stdout)] == ["arm"]
    shell("release", "arm", "--yes")
    assert json.loads(shell("get", "requests", "-o", "json").stdout) == []
    shell("request", "arm", "--wait")
    Client(str(shell.state / "run/rorg.sock")).release("arm")
    assert json.loads(shell("get", "requests", "-o", "json").stdout) == [], "a program gives up its own unasked"


@pytest.mark.slow
def test_another_try_of_a_change_asks_where_it_replaces_a_driver(shell):  # noqa: F811
    good = {"always_on": True, "driver": {}, "update": {"bake": "100ms", "when": "now"}}
    write_tree(shell.tree, {"base": good})
    shell.run()
    before = run_of(shell, "base")
    write_tree(shell.tree, {"base": {**good, "command": ["false"], "ready": {"tcp": 1, "timeout": "1s"}}})

    def failed() -> bool:
        found = json.loads(shell("get", "services", "base", "-o", "json").stdout)[0]
        return any(c["reason"] == "Quarantined" for c in found["conditions"])

    wait_for(failed)
    wait_for(lambda: run_of(shell, "base") not in ("", before))
    refused = shell("retry", "base", code=5).stderr
    assert "base moves hardware" in refused
    assert "--yes" in refused
    shell("retry", "base", "--yes")
