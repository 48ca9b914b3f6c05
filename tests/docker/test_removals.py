"""A typing error in a name stops nothing: what was named stays until a person has confirmed that it goes."""

from __future__ import annotations

import os

import commands
import pytest
from robots import RealRobot, VirtualRobot, write_tree

TREE = {"core": {}, "panel": {"needs": ["core"]}, "guide": {}}


def rorg(robot: RealRobot, *args: str) -> tuple[int, str]:
    done = commands.run([*args], {**os.environ, "RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "docker"})
    return done.returncode, done.stdout + done.stderr


def misspell(robot: RealRobot, name: str, to: str) -> None:
    path = robot.tree / f"services/{name}.yaml"
    path.write_text(path.read_text().replace(f"name: {name}\n", f"name: {to}\n"))


def run_of(robot: RealRobot, name: str) -> tuple[str, str, bool]:
    found = robot.engine.api().inspect_container(name)
    return found["Id"], found["State"]["StartedAt"], found["State"]["Running"]


@pytest.fixture
def robot(dockerd, tmp_path):
    """A panel that a request names, and the core that only it needs, on Docker."""
    found = RealRobot(tmp_path, "docker", dockerd.host, with_server=True)
    found.declare(TREE)
    found.request("panel", id="tour")
    found.wait(lambda: found.active() == {"core", "panel"} and found.quiet())
    yield found
    found.close()


def withheld(robot: RealRobot) -> set[str]:
    return set(robot.status().get("withheld", {}))


def test_a_typing_error_in_the_name_of_a_running_service_stops_nothing(robot):
    before = run_of(robot, "panel"), run_of(robot, "core")
    misspell(robot, "panel", "panle")
    robot.wait(lambda: withheld(robot) == {"panel"} and "panle" in robot.states())
    assert "request 'tour' of developer names it" in robot.waits("panel")
    assert any("panel.yaml" in line and "'panle'" in line for line in robot.lines), "a file and a name differ"
    for words in (
        ("diff", str(robot.tree)),
        ("get",),
        ("get", "services", "panel"),
        ("why", "panel"),
        ("describe", "panel"),
    ):
        code, said = rorg(robot, *words)
        assert "withheld" in said, (words, said)
    code, said = rorg(robot, "apply", str(robot.tree))
    assert code == 5, "nobody was asked"
    assert "panel" in said, "nobody was asked"
    assert (run_of(robot, "panel"), run_of(robot, "core")) == before, "nor does what it needs end"
    robot.stop()
    robot.start()
    robot.wait(lambda: robot.loop.decision and set(robot.loop.decision.situation.withheld) == {"panel"})
    write_tree(robot.tree, {"guide": {}})
    robot.wait(lambda: withheld(robot) == {"panel", "core"} and "panle" not in robot.states())
    assert (run_of(robot, "panel"), run_of(robot, "core")) == before
    write_tree(robot.tree, TREE)
    robot.wait(lambda: not withheld(robot) and set(robot.states()) == {"core", "panel", "guide"} and robot.quiet())
    assert (run_of(robot, "panel"), run_of(robot, "core")) == before, "mended: nothing had happened"


def test_what_is_confirmed_goes_and_nothing_else(robot):
    write_tree(robot.tree, {"core": {}})
    robot.wait(lambda: withheld(robot) == {"panel"} and "guide" not in robot.states())
    before = run_of(robot, "core")
    code, said = rorg(robot, "apply", str(robot.tree), "--yes")
    assert code == 0, said
    assert "panel" in said, said
    robot.wait(lambda: set(robot.states()) == {"core"} and not withheld(robot))
    assert run_of(robot, "core")[0] == before[0]
    robot.wait(lambda: "\nremovals:" not in robot.state.requests.read_text())
    write_tree(robot.tree, {"core": {}, "panel": {}})
    robot.wait(lambda: robot.active() == {"panel"})
    write_tree(robot.tree, {"core": {}})
    robot.wait(lambda: withheld(robot) == {"panel"})
    assert robot.active() == {"panel"}, "a confirmation ends with what it was for"


def test_apply_without_a_running_rorg_asks_and_removes(robot):
    robot.stop()
    write_tree(robot.tree, {"core": {}})
    assert rorg(robot, "apply", str(robot.tree))[0] == 5
    assert robot.active() == {"core", "panel"}
    assert "withheld" in rorg(robot, "why", "panel")[1]
    code, said = rorg(robot, "apply", str(robot.tree), "--yes", "--wait")
    assert code == 0, said
    assert set(robot.states()) == {"core"}, said
    assert "\nremovals:" not in robot.state.requests.read_text()


def test_a_tree_that_declares_nothing_any_more_removes_nothing_until_that_is_confirmed(robot):
    robot.stop()
    policy = {"policy": {"bulk_workers": 4}}
    write_tree(robot.tree, TREE, requests={"lights": {"services": ["guide"]}}, policies=policy)
    robot.start()
    robot.wait(lambda: robot.active() == {"core", "panel", "guide"} and robot.quiet())
    before = [run_of(robot, name) for name in TREE]
    write_tree(robot.tree, {}, policies=policy)
    robot.wait(lambda: withheld(robot) == set(TREE))
    for words in (("diff", str(robot.tree)), ("get",), ("why", "guide"), ("describe", "panel")):
        code, said = rorg(robot, *words)
        assert "withheld" in said, (words, said)
        assert "no longer declare any service" in said, (words, said)
        assert "rorg apply" in said or words[0] != "diff", (words, said)
    assert standing(robot) == "applying", "nobody has seen it do well"
    assert [r["id"] for r in robot.status()["requests"]] == ["lights", "tour"]
    robot.stop()
    robot.start()
    robot.wait(lambda: withheld(robot) == set(TREE))
    assert [run_of(robot, name) for name in TREE] == before, "nor do they end with another rorg"
    robot.kill("guide")
    robot.wait(lambda: run_of(robot, "guide")[2] and run_of(robot, "guide") != before[2])
    assert rorg(robot, "apply", str(robot.tree))[0] == 5, "nobody was asked"
    code, said = rorg(robot, "apply", str(robot.tree), "--yes")
    assert code == 0, said
    robot.wait(lambda: not robot.states() and not withheld(robot))
    robot.wait(lambda: standing(robot) == "good")
    write_tree(robot.tree, TREE)
    robot.wait(lambda: robot.active() == {"core", "panel"}, 90)


def standing(robot: RealRobot) -> str:
    return robot.client().call("GET", "/v1/history?most=1")[0]["standing"]


def test_only_what_was_shown_is_confirmed(robot):
    from rorg.client import Error

    with pytest.raises(Error, match="not withheld"):
        robot.client().call("PUT", "/v1/removals", {"services": ["panel"]})
    write_tree(robot.tree, {"other": {}})
    robot.wait(lambda: withheld(robot) == {"panel", "core"})
    robot.client().call("PUT", "/v1/removals", {"services": ["panel"]})
    robot.wait(lambda: "panel" not in robot.states())
    assert "core" in withheld(robot)
    assert "core" in robot.states()


def test_deleting_an_image_confirms_nothing_of_a_service_of_its_name(tmp_path):
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    robot.declare(TREE)
    try:
        robot.request("panel", id="tour")
        robot.wait(lambda: robot.active() == {"core", "panel"} and robot.quiet())
        client = robot.client()
        text = "apiVersion: rorg/v1\nkind: Image\nmetadata: {name: panel}\nspec: {import: 'true'}\n"
        found = client.put_manifest("Image", "panel", text, None)
        misspell(robot, "panel", "panle")
        robot.wait(lambda: withheld(robot) == {"panel"})
        client.delete_manifest("Image", "panel", found["digest"])
        assert robot.file.now().removals == ()
        assert client.service("panel")["withheld"]
        assert robot.active() == {"core", "panel"}
        client.call("PUT", "/v1/removals", {"services": ["panel"]})
        robot.wait(lambda: robot.active() == set())
    finally:
        robot.close()


@pytest.fixture
def virtual(tmp_path):
    return VirtualRobot(tmp_path)


@pytest.mark.parametrize(
    ("services", "more", "request_", "left", "kept"),
    [
        ({"core": {}, "nav": {"needs": ["core"], "always_on": True}}, {}, (), {"nav": {"always_on": True}}, "core"),
        ({"core": {}, "nav": {}}, {"groups": {"all": {"services": ["core", "nav"]}}}, ("nav",), {"nav": {}}, "core"),
        (
            {"core": {}, "nav": {}},
            {"groups": {"all": {"services": ["core"]}}},
            ("all",),
            {"nav": {}, "core": {}},
            "all",
        ),
    ],
    ids=["need", "group", "a group's name"],
)
def test_whatever_named_it(virtual, services, more, request_, left, kept):
    virtual.declare(services, **more)
    if request_:
        virtual.request(*request_)
    virtual.settle()
    before = {c.id for c in virtual.containers()}
    active = virtual.active()
    virtual.declare(left)
    virtual.wait(lambda: kept in virtual.sim.decision.situation.withheld)
    began = virtual.now()
    virtual.sim.at(began + 30.0, lambda: None)
    virtual.wait(lambda: virtual.now() >= began + 30.0)
    assert {c.id for c in virtual.containers()} == before
    assert virtual.active() == active or kept not in virtual.sim.decision.situation.wanted, "unless nobody wants it"
    virtual.change(
        lambda asked: asked.__class__(
            **{**{f: getattr(asked, f) for f in ("requests", "restarts", "holds", "suspended")}, "removals": (kept,)}
        )
    )
    virtual.wait(lambda: not virtual.sim.decision.situation.withheld and not virtual.sim.document.removals)
    virtual.wait(lambda: "core" not in virtual.active())


def test_what_nobody_named_goes_at_once_and_all_where_the_policy_says_so(virtual):
    virtual.declare({"core": {}, "spare": {}, "nav": {}}, policies={"policy": {"removals": "auto"}})
    virtual.request("core")
    virtual.settle()
    virtual.declare({"nav": {}}, policies={"policy": {"removals": "auto"}})
    virtual.settle()
    assert set(virtual.states()) == {"nav"}
    virtual.declare({"nav": {}, "spare": {}})
    virtual.settle()
    virtual.declare({"nav": {}})
    virtual.settle()
    assert set(virtual.states()) == {"nav"}
