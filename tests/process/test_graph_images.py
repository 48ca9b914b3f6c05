"""What images stand on: levels and descendants, `rorg graph images` in all forms, and names with / and : everywhere."""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree

import commands
import pytest
import yaml
from common import BASE_IMAGE, ROOT, wait_for
from editors import EDITOR
from image_manifests import images
from robots import RealRobot, write_tree
from tools import graphviz

from rorg.cli.graph import command
from rorg.cli.names import declared
from rorg.core.desired import desire
from rorg.images.graph import descendants, generations, hierarchy, reduced, services_on
from rorg.manifest.load import load_or_raise
from rorg.model.graph import made_from, stands_on
from rorg.model.image_names import with_identity

NAVIGATION = "lab/navigation:1.2"
DOCKERFILES = {
    "deploy": f"FROM {BASE_IMAGE}",
    "fetch": "FROM deploy:latest",
    "maps": "FROM scratch",
    NAVIGATION: "FROM fetch\nCOPY --from=deploy /a /a\nCOPY --from=maps /m /m",
}
SERVICES = {
    "nav": {"image": NAVIGATION, "needs": ["cam"]},
    "slam": {"image": NAVIGATION},
    "cam": {"image": "deploy:latest"},
}
EDGES = [("deploy", BASE_IMAGE), ("fetch", "deploy")] + [(NAVIGATION, base) for base in ("deploy", "fetch", "maps")]


WITHOUT_A_DOCKERFILE = {
    "behavioral_state_machine",
    "dialogue_report",
    "portainer",
    "ros_fetch_estop_server",
    "roscore",
} | {
    "ros_selfie_view",
    "text_to_audio_server",
}
"""Images of TritonBot that its repository only names."""


@pytest.fixture(scope="module")
def tritonbot():
    return load_or_raise(ROOT / "manifests")


def test_tritonbot_has_four_levels_of_its_own_above_its_stand_in(tritonbot):
    """One stand-in is in the place of its four external images, and made from this machine's own Python."""
    levels = generations(hierarchy(stands_on(tritonbot.images)))
    assert levels[:2] == [["rorg-base"], ["standin"]]
    assert sum(map(len, levels[2:])) == 36 + len(WITHOUT_A_DOCKERFILE)
    chain = ["ros_deploy_base", "fetch_deploy_base", "dockerlogin_fetch", "dockerlogin_fetch_nvidia"]
    assert [name in names for name, names in zip(chain, levels[2:], strict=True)] == [True] * 4


@pytest.mark.parametrize(
    ("name", "count"), [("ros_deploy_base", 24), ("fetch_deploy_base", 6), ("nonros_deploy_base", 5), ("roscore", 0)]
)
def test_tritonbot_has_the_descendants_of_its_dockerfiles(tritonbot, name, count):
    graph = hierarchy(stands_on(tritonbot.images))
    assert len(descendants(graph, name) - WITHOUT_A_DOCKERFILE) == count


def test_a_change_of_the_base_concerns_every_container_of_tritonbot(tritonbot):
    graph, made = hierarchy(stands_on(tritonbot.images)), made_from(tritonbot)
    assert services_on(graph, made, "rorg-base") == sorted(n for n, s in tritonbot.services.items() if s.spec)
    assert "navigation" in services_on(graph, made, "fetch_deploy_base")
    assert services_on(graph, made, "dockerlogin_fetch_nvidia") == []


def test_services_that_are_made_from_what_an_image_contains_are_made_from_that_image(tritonbot):
    """As a running rorg on Docker has them."""
    tags = {name: with_identity(name, "0123456789abcdef") for name in tritonbot.images}
    desired = desire(tritonbot, images=tags).catalog
    assert desired.services["navigation"].spec["image"] == "ros_fetch_navigation:0123456789ab"
    assert made_from(desired) == made_from(tritonbot)
    assert desire(desired).catalog == desired


def test_an_arrow_that_a_longer_way_says_is_left_out():
    graph = hierarchy({"a": ["x"], "b": ["a", "x"], "c": ["b", "a", "x"]})
    assert generations(graph) == [["x"], ["a"], ["b"], ["c"]]
    assert sorted(reduced(graph).edges) == [("a", "b"), ("b", "c"), ("x", "a")]
    assert services_on(graph, {"c": ["one"], "a": ["two"], "x": ["three"]}, "a") == ["one", "two"]


# -- the command ------------------------------------------------------------------------------------------------

TREE = f"""\
maps
{BASE_IMAGE} (external)
  deploy
    fetch
      {NAVIGATION} (also on deploy, maps)
"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    assert images(folder, DOCKERFILES, SERVICES).diagnostics == ()
    found = RealRobot(folder, "process", None, with_server=True)
    found.start()
    yield found
    found.close()


@pytest.fixture(params=["served", "alone"])
def graph(request, robot):
    """`rorg graph images`: what it prints."""

    def call(*words: str, code: int = 0) -> str:
        where = {"RORG_STATE_DIR": str(robot.state.path if request.param == "served" else robot.tree / "none")}
        directory = [] if request.param == "served" else [str(robot.tree)]
        return commands.rorg("graph", "images", *directory, *words, code=code, RORG_ENGINE="process", **where).stdout

    return call


def test_images_are_a_tree(graph):
    assert graph() == TREE


def test_edges_say_what_a_change_concerns(graph):
    rows = [line.split() for line in graph("-o", "wide").splitlines()]
    assert rows[0] == ["FROM", "TO", "LEVEL", "DESCENDANTS", "SERVICES"]
    assert sorted((row[0], row[1]) for row in rows[1:]) == sorted(EDGES)
    assert ["deploy", BASE_IMAGE, "1", "2", "3"] in rows
    assert ["fetch", "deploy", "2", "1", "2"] in rows


@pytest.mark.slow
def test_programs_get_names_parents_first_and_all_of_it_as_json_and_yaml(graph):
    assert graph("-o", "name").split() == ["maps", "deploy", "fetch", NAVIGATION]
    told = json.loads(graph("-o", "json"))
    assert told == yaml.safe_load(graph("-o", "yaml"))
    assert told["images"] == sorted(DOCKERFILES)
    assert told["external"] == [BASE_IMAGE]
    assert sorted((edge["from"], edge["to"]) for edge in told["edges"]) == sorted(EDGES)
    assert told["services"] == {NAVIGATION: ["nav", "slam"], "deploy": ["cam"]}
    assert told["levels"] == [["maps", BASE_IMAGE], ["deploy"], ["fetch"], [NAVIGATION]]


def test_it_is_drawn_without_what_a_longer_way_says(graph):
    drawn = graph("-o", "dot")
    assert f'"{BASE_IMAGE}" [style=dashed];' in drawn
    assert f'"{NAVIGATION}" -> "fetch";' in drawn
    assert f'"{NAVIGATION}" -> "deploy";' not in drawn
    drawn = graph("-o", "mermaid").splitlines()
    assert drawn[0] == "graph LR"
    assert f'  i2["{NAVIGATION}"] --> fetch' in drawn


def test_the_picture_has_a_column_for_each_level(graph):
    graphviz()
    picture = ElementTree.fromstring(graph("-o", "svg"))
    place = {"svg": "http://www.w3.org/2000/svg"}
    lefts = {
        g.find("svg:text", place).text: float(g.find("svg:rect", place).get("x"))
        for g in picture.iterfind("svg:g", place)
        if g.find("svg:text", place).text != "name"  # of the legend
    }
    assert lefts[NAVIGATION] < lefts["fetch"] < lefts["deploy"] < lefts[BASE_IMAGE]
    curves = [p for p in picture.findall("svg:path", place) if "C" in p.get("d")]
    assert len(curves) == len(EDGES) - 1


def test_services_have_a_picture_too(robot):
    graphviz()
    drawn = commands.rorg("graph", "-o", "svg", RORG_STATE_DIR=str(robot.state.path)).stdout
    assert {t.text for t in ElementTree.fromstring(drawn).iterfind("{*}g/{*}text")} == {*SERVICES, "developer"}
    assert commands.rorg(
        "graph", "services", "-o", "name", RORG_STATE_DIR=str(robot.state.path)
    ).stdout.split() == sorted([*SERVICES, "developer"])


def test_a_graph_that_there_is_not(tmp_path):
    said = commands.rorg("graph", "imags", code=2, cwd=tmp_path, RORG_STATE_DIR=str(tmp_path)).stderr
    assert said == "rorg: cannot find the graph 'imags': no such graph; try 'images'\n"


@pytest.mark.parametrize("form", ["table", "wide", "name", "yaml", "json", "dot", "mermaid", "svg"])
def test_a_tree_without_images_has_a_graph_too(tmp_path, capsys, monkeypatch, form):
    if form == "svg":
        graphviz()
    monkeypatch.setenv("RORG_STATE_DIR", str(tmp_path / "state"))
    write_tree(tmp_path / "tree", {"nav": {}})
    command("images", tmp_path / "tree", form)
    said = capsys.readouterr()
    assert (BASE_IMAGE in said.out, said.err) == (False, "")


def test_images_are_listed_with_what_they_stand_on(robot):
    state = {"RORG_STATE_DIR": str(robot.state.path)}
    rows = [
        re.split(r"  +", line) for line in commands.rorg("get", "images", "-o", "wide", **state).stdout.splitlines()
    ]
    assert rows[0] == ["NAME", "FROM", "SERVICES", "CONTEXT", "DOCKERFILE"]
    context = robot.tree.parent / "lab-navigation-1.2"
    assert [NAVIGATION, "fetch, deploy, maps", "2", str(context), "Dockerfile"] in rows
    assert ["maps", "scratch", "0", str(robot.tree.parent / "maps"), "Dockerfile"] in rows
    told = json.loads(commands.rorg("get", "images", NAVIGATION, "-o", "json", **state).stdout)
    assert [(i["bases"], i["services"]) for i in told] == [(["fetch", "deploy", "maps"], ["nav", "slam"])]


# -- names with / and : -----------------------------------------------------------------------------------------


def test_the_api_takes_such_names(robot):
    client, name = robot.client(), "lab:5000/arm:2"
    (robot.tree.parent / "arm").mkdir()
    (robot.tree.parent / "arm/Dockerfile").write_text("FROM fetch")
    text = f"apiVersion: rorg/v1\nkind: Image\nmetadata: {{name: '{name}'}}\nspec: {{context: ../../arm}}\n"
    assert client.put_manifest("Image", name, text, None)["file"] == "images/lab-5000-arm-2.yaml"
    assert client.manifest("Image", name) == text
    wait_for(lambda: name in client.call("GET", "/v1/graph/images")["images"])
    found = {m["name"]: m["digest"] for m in client.manifests() if m["kind"] == "Image"}
    assert set(found) == {*DOCKERFILES, name}
    client.delete_manifest("Image", name, found[name])
    assert not (robot.tree / "images/lab-5000-arm-2.yaml").exists()
    wait_for(lambda: name not in client.call("GET", "/v1/graph/images")["images"])


def test_such_an_image_is_edited(robot, tmp_path):
    script = tmp_path / "editor.py"
    script.write_text(f"{EDITOR}\ntext += '  args: {{}}\\n'\npath.write_text(text)")
    editor = {"VISUAL": "", "EDITOR": f"python3 '{script}'", "TMPDIR": str(tmp_path)}
    said = commands.rorg("edit", f"image/{NAVIGATION}", RORG_STATE_DIR=str(robot.state.path), **editor).stdout
    assert said == f"image {NAVIGATION} edited\n"
    assert (robot.tree / "images/lab-navigation-1.2.yaml").read_text().endswith("  args: {}\n")


@pytest.mark.parametrize(
    ("shell", "words", "offered"),
    [
        ("fish", ["build", "lab/nav"], [NAVIGATION]),
        ("bash", ["build", "lab/nav"], [NAVIGATION]),
        ("bash", ["build", "lab/navigation", ":"], ["1.2"]),
        ("bash", ["build", "lab/navigation", ":", "1"], ["1.2"]),
        ("bash", ["build", "--engine", "=", "pro"], ["process"]),
        ("zsh", ["build", "lab/navigation:1"], [NAVIGATION.replace(":", "\\:")]),
    ],
)
def test_a_shell_completes_such_names(robot, shell, words, offered):
    """Bash takes the signs = and : for words, and completes what stands behind the last of them."""
    state = {"RORG_STATE_DIR": str(robot.state.path), "_RORG_COMPLETE": shell}
    assert commands.rorg(*words, **state).stdout.splitlines() == offered


def test_a_glance_sees_such_names(robot):
    assert declared(robot.tree, ("image",)) == sorted(DOCKERFILES, key=lambda name: name.replace("/", "-"))
