"""Images: order from FROM lines, parents first, a failure stops what stands on it."""

from __future__ import annotations

import pytest
from conftest import BASE_IMAGE, ROOT
from robots import write_tree

from rorg.engines.docker.engine import DockerEngine
from rorg.images.build import build, order, parents
from rorg.images.docker import DockerBuilder
from rorg.manifest.load import load_or_raise


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("FROM a", ["a"]),
        (
            "# FROM x\nFROM --platform=linux/amd64 a:1 AS one\nFROM one\nCOPY --from=one /x /x\nCOPY --from=b /y /y",
            ["a:1", "b"],
        ),
        ("ARG BASE=a\nFROM ${BASE}", ["a"]),
        ("ARG BASE=a\nFROM $BASE:2", ["a:2"]),
        ("FROM ${BASE:-z}", ["z"]),
        ("from \\\n  a", ["a"]),
        ("FROM scratch", []),
    ],
)
def test_parents_of_a_dockerfile(text, expected):
    assert parents(text, {}) == expected


def test_build_arguments_choose_the_parent():
    assert parents("ARG BASE=a\nFROM ${BASE}", {"BASE": "b"}) == ["b"]


def test_tritonbot_parents_come_first():
    catalog = load_or_raise(ROOT / "manifests")
    done: set[str] = set()
    for name, below in order(catalog, catalog.images):
        assert set(below) <= done, name
        done.add(name)
    assert len(done) == 45


def image_tree(folder, dockerfiles: dict[str, str]):
    write_tree(folder / "tree", {"camera": {}})
    (folder / "tree" / "images").mkdir()
    for name, text in dockerfiles.items():
        context = folder / name
        context.mkdir()
        (context / "Dockerfile").write_text(text)
        (folder / "tree" / "images" / f"{name}.yaml").write_text(
            f"apiVersion: rorg/v1\nkind: Image\nmetadata: {{name: {name}}}\nspec: {{context: ../../{name}}}\n"
        )
    return load_or_raise(folder / "tree")


def test_a_failure_stops_its_descendants_and_nothing_else(dockerd, tmp_path):
    catalog = image_tree(
        tmp_path,
        {
            "bad": f"FROM {BASE_IMAGE}\nCOPY nothing-here /x",
            "child": "FROM bad",
            "grandchild": "FROM child",
            "good": f"FROM {BASE_IMAGE}\nLABEL a=b",
            "leaf": "FROM good\nLABEL c=d",
            "lost": "FROM not.there/at-all",
        },
    )
    builder = DockerBuilder(DockerEngine("test", dockerd.host))
    results = build(catalog, sorted(catalog.images), builder, lambda line: None)
    found = {r.image: r.outcome for r in results}
    assert found == {
        BASE_IMAGE: "present",
        "bad": "failed",
        "child": "skipped",
        "grandchild": "skipped",
        "good": "built",
        "leaf": "built",
        "not.there/at-all": "failed",
        "lost": "skipped",
    }
    assert builder.has("leaf")
    assert not builder.has("child")
    builder.remove(["good", "leaf"])


def test_a_parent_that_changed_is_in_its_children(dockerd, tmp_path):
    catalog = image_tree(tmp_path, {"parent": f"FROM {BASE_IMAGE}\nLABEL v=1", "child": "FROM parent"})
    engine = DockerEngine("test", dockerd.host)
    builder = DockerBuilder(engine)
    build(catalog, ["child"], builder, lambda line: None)
    (tmp_path / "parent" / "Dockerfile").write_text(f"FROM {BASE_IMAGE}\nLABEL v=2")
    build(catalog, ["child"], builder, lambda line: None)
    assert engine.api().inspect_image("child")["Config"]["Labels"]["v"] == "2"
    builder.remove(["parent", "child"])
