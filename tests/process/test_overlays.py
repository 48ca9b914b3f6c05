"""One tree for a fleet: what robots/NAME/ lays over the base."""

from __future__ import annotations

import json
import os

import commands
import pytest
from repositories import Repository
from robots import RealRobot, write_tree
from thin_commands import rorg

from rorg.daemon.commit_tree import load_at
from rorg.daemon.tree import Tree
from rorg.manifest.documents import read_tree
from rorg.manifest.load import load
from rorg.manifest.overlay import merge, robot_for
from rorg.manifest.yaml_source import read_yaml
from rorg.model.diagnostics import collected

BASE = {
    "base": {
        "needs": ["lidar"],
        "resources": {"cpu": 1},
        "container": {"environment": {"MAP": "lab", "SPEED": "2"}, "group_add": ["a", "b"]},
    },
    "lidar": {"ready": {"delay": "1s"}},
    "old": {},
}


@pytest.fixture
def tree(tmp_path):
    return write_tree(tmp_path / "tree", BASE)


def lay(tree, robot: str, name: str, text: str, folder: str = "services") -> None:
    """Writes a document of an overlay: the Service `name`, with what is said of it."""
    place = tree / "robots" / robot / folder
    place.mkdir(parents=True, exist_ok=True)
    (place / f"{name}.yaml").write_text(f"apiVersion: rorg/v1\nkind: Service\nmetadata: {{name: {name}}}\n{text}")


def services(tree, robot: str = "") -> dict:
    loaded = load(tree, robot=robot)
    assert loaded.catalog, loaded.errors
    return dict(loaded.catalog.services)


# -- rules -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("over", "result"),
    [
        ("{}", {"a": {"b": 1, "c": [1, 2]}, "d": "x"}),
        ("{a: {b: 2}}", {"a": {"b": 2, "c": [1, 2]}, "d": "x"}),
        ("{a: {c: [3]}}", {"a": {"b": 1, "c": [3]}, "d": "x"}),
        ("{a: null}", {"d": "x"}),
        ("{a: {b: ~, e: {f: 1}}}", {"a": {"c": [1, 2], "e": {"f": 1}}, "d": "x"}),
        ("{nothing: null}", {"a": {"b": 1, "c": [1, 2]}, "d": "x"}),
        ("{a: text, d: {e: 1}}", {"a": "text", "d": {"e": 1}}),
    ],
)
def test_mappings_are_merged_all_else_is_replaced_and_null_takes_away(over, result):
    texts = {"base": "{a: {b: 1, c: [1, 2]}, d: x}", "over": over}
    base, upper = (read_yaml(text, file)[0] for file, text in texts.items())
    merged = merge(base, upper)
    assert merged.value == result
    for path in merged.values:
        value = result
        for key in path:
            value = value[key]  # of every value that has a place there is one
        where = merged.where(path)
        assert (where.line, where.column) == {"base": base, "over": upper}[where.file].values[path]


def test_an_overlay_changes_adds_and_removes(tree):
    text = "spec:\n  needs: null\n  resources: {memory: 1Gi}\n  container: {environment: {MAP: hall}, group_add: [c]}\n"
    lay(tree, "nora", "base", text)
    lay(tree, "nora", "arm", "spec: {image: x, always_on: true}\n")
    lay(tree, "nora", "old", "removed: true\n")
    plain, nora = services(tree), services(tree, "nora")
    assert set(plain) == {"developer", "base", "lidar", "old"}
    assert set(nora) == {"developer", "base", "lidar", "arm"}
    base = nora["base"]
    assert (base.needs, base.cpu, base.memory) == ((), 1.0, 1 << 30)
    assert {k: base.spec["environment"][k] for k in ("MAP", "SPEED")} == {"MAP": "hall", "SPEED": "2"}
    assert base.spec["group_add"] == ["c"]
    assert plain["base"].spec["environment"]["MAP"] == "lab"
    assert nora["lidar"] == plain["lidar"]


def test_paths_are_beside_the_manifest_of_the_base(tree):
    (tree / "services/maps").mkdir()
    lay(tree, "nora", "lidar", "spec: {mounts: ['./maps:/maps']}\n")
    lay(tree, "nora", "own", "spec: {image: x, mounts: ['./own:/own']}\n")
    (tree / "robots/nora/services/own").mkdir()
    nora = services(tree, "nora")
    assert nora["lidar"].spec["volumes"][-1] == f"{tree}/services/maps:/maps:ro"
    assert nora["own"].spec["volumes"][-1] == f"{tree}/robots/nora/services/own:/own:ro"


@pytest.mark.parametrize(
    ("name", "text", "place", "message"),
    [
        ("base", "spec:\n  needs: [lidra]\n", "robots/nora/services/base.yaml:5:11", "needs unknown service 'lidra'"),
        ("base", "spec:\n  nedes: []\n", "robots/nora/services/base.yaml:5:3", "unknown key 'nedes'"),
        ("base", "spec:\n  image: null\n", "services/base.yaml:6:3", "spec: 'image' is missing"),
        ("lidra", "removed: true\n", "robots/nora/services/lidra.yaml:3:18", "there is no Service 'lidra'"),
        ("lidar", "removed: true\n", "services/base.yaml:19:5", "needs unknown service 'lidar'"),
        ("base", "removed: 1\n", "robots/nora/services/base.yaml:4:1", "unknown key 'removed'"),
        ("base", "spec: [\n", "robots/nora/services/base.yaml", "not valid YAML"),
        ("nothing", "spec: {}\n", "robots/nora/services/nothing.yaml", "image"),
    ],
)
def test_an_error_is_told_where_it_is_written(tree, name, text, place, message):
    lay(tree, "nora", name, text)
    assert load(tree).catalog, "the base is right"
    errors = [str(error).replace(f"{tree}/", "") for error in load(tree, robot="nora").errors]
    assert any(error.startswith(place) and message in error for error in errors), errors


def test_a_manifest_in_the_folder_of_another_kind_is_told(tree):
    lay(tree, "nora", "arm", "spec: {image: x}\n", folder="groups")
    assert [error.remedy for error in load(tree, robot="nora").errors] == ["folder 'services'"]


def test_who_a_tree_is_read_for(tree):
    for name in ("nora", "emil"):
        (tree / "robots" / name).mkdir(parents=True)
    assert robot_for(tree, "", "nora.example.org") == "nora"
    assert robot_for(tree, "", "laptop") == ""
    assert robot_for(tree, "emil", "nora") == "emil"
    found = load(tree, robot="nroa").errors
    assert [(error.message, error.remedy) for error in found] == [("no robot 'nroa'", "'nora'")]
    assert load(tree, robot="../robots/nora").errors, "a name, no path"


def test_an_overlay_may_not_read_what_lies_elsewhere(tree, tmp_path):
    (tmp_path / "secret.yaml").write_text("kind: Service\n")
    lay(tree, "nora", "arm", "spec: {image: x}\n")
    os.symlink(tmp_path / "secret.yaml", tree / "robots/nora/services/link.yaml")
    assert ["leads out" in error.message for error in load(tree, robot="nora").errors] == [True]


# -- the tree of a loop ----------------------------------------------------------------------------------------


def test_a_change_of_its_overlay_is_seen_and_one_of_another_robot_is_not(tree):
    seen = Tree(tree, host="nora.local")
    seen.read_now()
    assert (seen.robot, seen.desired.catalog.services["base"].cpu) == ("", 1.0)
    lay(tree, "nora", "base", "spec: {resources: {cpu: 2}}\n")
    assert seen.read() == (True, False)
    assert (seen.robot, seen.desired.catalog.services["base"].cpu) == ("nora", 2.0)
    assert {tree / "robots", tree / "robots/nora", tree / "robots/nora/services"} <= set(seen.folders())
    lay(tree, "emil", "base", "spec: {resources: {cpu: 3}}\n")
    assert seen.read() == (False, False)
    lay(tree, "nora", "base", "spec: {resources: 3}\n")
    assert seen.read() == (True, False)
    assert seen.errors
    assert seen.desired.catalog.services["base"].cpu == 2.0, "the last good one"


def test_the_overlay_of_a_past_state_is_that_of_then(tmp_path):
    repository = Repository(tmp_path / "robot")
    write_tree(repository.tree, BASE)
    before = repository.commit()
    lay(repository.tree, "nora", "base", "spec: {resources: {cpu: 2}}\n")
    first = repository.commit()
    lay(repository.tree, "nora", "base", "spec: {resources: {cpu: 3}}\n")
    tree = Tree(repository.tree.resolve(), host="nora")
    cpus = [load_at(tree, rev).catalog.services["base"].cpu for rev in (before, first, "HEAD")]
    assert cpus == [1.0, 2.0, 2.0]


# -- commands --------------------------------------------------------------------------------------------------


@pytest.fixture
def robot(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = RealRobot(tmp_path, "process", None, with_server=True)
    write_tree(found.tree, {"base": {"always_on": True}, "old": {}})
    lay(found.tree, "nora", "base", "spec:\n  priority: 60\n  container: {environment: {MAP: hall}}\n")
    lay(found.tree, "emil", "arm", "spec: {image: x, command: sleep 9, always_on: true}\n")
    yield found
    found.close()


@pytest.mark.slow
def test_commands_take_the_robot_by_name_and_by_variable(robot):
    at = str(robot.tree)
    assert "arm" not in rorg(robot, "diff", at, code=1).stdout
    assert "arm" in rorg(robot, "diff", at, "--robot", "emil", code=1).stdout
    environment = {"RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "process", "RORG_ROBOT": "emil"}
    assert "arm" in commands.rorg("diff", at, code=1, **environment).stdout
    for line in (("diff", at), ("validate", at), ("explain", "base", at), ("run", at), ("graph", at), ("apply", at)):
        said = rorg(robot, *line, "--robot", "nroa", code=2).stderr
        assert "cannot use the robot 'nroa'" in said, line
        assert said.rstrip().endswith("try 'nora'"), line


def test_explain_names_the_file_of_the_overlay(robot):
    said = rorg(robot, "explain", "base", str(robot.tree), "--robot", "nora", "-o", "json").stdout
    sources = {v["field"]: v["source"] for v in json.loads(said)["values"]}
    over = {"kind": "manifest", "file": f"{robot.tree}/robots/nora/services/base.yaml"}
    assert sources["priority"] == {**over, "line": 5}
    assert sources["container.environment.MAP"] == {**over, "line": 6}
    assert sources["always_on"]["file"] == f"{robot.tree}/services/base.yaml"


def test_validate_checks_the_base_and_every_robot_and_tells_each_error_once(robot):
    assert "2 services, 2 robots" in rorg(robot, "validate", str(robot.tree)).stderr
    lay(robot.tree, "emil", "base", "removed: true\n")
    lay(robot.tree, "nora", "more", "spec: {image: x, needs: [arm]}\n")
    text = (robot.tree / "services/old.yaml").read_text()
    (robot.tree / "services/old.yaml").write_text(text + "  needs: [nobody]\n")
    said = rorg(robot, "validate", str(robot.tree), code=2).stderr
    assert said.count("'nobody'") == 1
    assert said.count("needs unknown service 'arm' (on nora)") == 1
    assert "2 errors" in said
    assert "'arm'" not in rorg(robot, "validate", str(robot.tree), "--robot", "emil", code=2).stderr


@pytest.mark.slow
def test_a_running_rorg_says_whose_overlay_counts_and_another_one_is_compared_without_it(robot, monkeypatch):
    monkeypatch.setattr(os, "uname", lambda: type("Machine", (), {"nodename": "nora.example.org"}))
    robot.start()
    robot.wait(lambda: robot.active() == ["base"] or set(robot.active()) == {"base"})
    robot.settle()
    assert robot.status()["tree"]["robot"] == "nora"
    assert rorg(robot, "diff").stdout == "No differences.\n"
    assert "arm" in rorg(robot, "diff", "--robot", "emil", code=1).stdout
    refused = rorg(robot, "apply", "--yes", "--robot", "emil", code=5).stderr
    assert f"follows {robot.tree} for nora" in refused
    robot.stop()
    assert rorg(robot, "diff", str(robot.tree)).stdout == "No differences.\n", "it is that robot still"


def test_the_sources_of_a_robot_know_where_each_value_stands(tree):
    lay(tree, "nora", "base", "spec:\n  resources: {cpu: 2}\n")
    base = next(s for s in collected(read_tree(tree, robot="nora"))[0][0] if s.name == "base")
    assert base.path == tree / "services/base.yaml"
    assert str(base.where("spec", "resources", "cpu")).endswith("robots/nora/services/base.yaml:5:20")
    assert base.where("spec", "needs", 0).file == str(base.path)
