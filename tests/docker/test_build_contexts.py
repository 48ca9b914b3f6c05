"""Images that are built from more than one context, as Compose's `additional_contexts` says."""

from __future__ import annotations

from pathlib import Path

import pytest
from built_images import BOTH, TAG, files_of
from common import BASE_IMAGE
from image_trees import orders_of
from robots import write_tree

from rorg.images.classic import query_of
from rorg.images.identity import Identities
from rorg.manifest.load import Loaded, load
from rorg.model.catalog import Catalog

DOCKERFILE = """FROM base
COPY --from=maps / /maps/
COPY --from=tools /tool /tool
COPY own /own
"""
SPEC = """  additional_contexts:
    maps: ../../maps
    tools: service:tooling
    base: docker-image://BASE
  cache_from: [nav, "type=registry,ref=lab/nav:1"]
""".replace("BASE", BASE_IMAGE)


def tree(folder: Path, spec: str = SPEC, dockerfile: str = DOCKERFILE) -> Loaded:
    """An Image `nav` of these lines, and another one that the service `tooling` is made from."""
    root = write_tree(folder / "tree", {"tooling": {"image": "toolbox"}})
    (root / "images").mkdir(exist_ok=True)
    for name, text, more in (("nav", dockerfile, spec), ("toolbox", f"FROM {BASE_IMAGE}\nCOPY tool /\n", "")):
        (folder / name).mkdir(exist_ok=True)
        (folder / name / "Dockerfile").write_text(text)
        head = f"apiVersion: rorg/v1\nkind: Image\nmetadata: {{name: {name}}}\nspec:\n  context: ../../{name}\n"
        (root / f"images/{name}.yaml").write_text(head + more)
    (folder / "nav/own").write_text("own")
    (folder / "toolbox/tool").write_text("tool")
    (folder / "maps/hall").mkdir(parents=True, exist_ok=True)
    (folder / "maps/hall/map.yaml").write_text("map")
    return load(root)


def catalog_of(loaded: Loaded) -> Catalog:
    assert loaded.diagnostics == ()
    assert loaded.catalog
    return loaded.catalog


@BOTH
def test_a_build_has_the_files_of_all_its_contexts(place, tmp_path):
    catalog = catalog_of(tree(tmp_path))
    results = place.build(orders_of(catalog, {BASE_IMAGE}))
    assert {name: r.message for name, r in results.items() if not r.good} == {}
    found = files_of(place, f"nav:{TAG}")
    assert {path: found[path][1] for path in ("maps/hall/map.yaml", "tool", "own")} == {
        "maps/hall/map.yaml": b"map",
        "tool": b"tool",
        "own": b"own",
    }


def test_what_a_context_is_stands_in_the_catalog(tmp_path):
    images = catalog_of(tree(tmp_path)).images
    assert images["nav"].stand_ins == {"base": BASE_IMAGE, "maps": "nav-maps-context", "tools": "toolbox"}
    assert images["nav"].bases == (BASE_IMAGE, "nav-maps-context", "toolbox")
    assert images["nav"].cache_from == ("nav", "lab/nav:1")
    assert images["nav-maps-context"].context == str(tmp_path / "maps")


def test_the_classic_builder_uses_its_own_layers_beside_others(tmp_path):
    image = catalog_of(tree(tmp_path)).images["nav"]
    assert query_of(orders_of(catalog_of(tree(tmp_path)), set())[0], image, "Dockerfile")["cachefrom"] == (
        '["nav", "lab/nav:1", "nav"]'
    )


def identity(folder: Path, spec: str = SPEC) -> str:
    return Identities().of(catalog_of(tree(folder, spec)))["nav"]


def test_contexts_are_part_of_the_identity_and_caches_are_not(tmp_path):
    before = identity(tmp_path)
    assert identity(tmp_path, SPEC.replace("[nav, ", "[")) == before
    assert identity(tmp_path, SPEC.replace("service:tooling", "toolbox")) == before
    assert identity(tmp_path, SPEC.replace("service:tooling", f"docker-image://{BASE_IMAGE}")) != before
    (tmp_path / "toolbox/tool").write_text("tool")
    (tmp_path / "maps/more").write_text("more")
    assert identity(tmp_path) != before


WRONG = [
    ("maps: ../../mpas", "additional_contexts.maps: no directory FOLDER/mpas; create it, or use "),
    ("maps: 'service:toolng'", "'service:toolng' is not a service with an image; try 'tooling'"),
    ("maps: https://example.org/maps.git", "cannot build from 'https://example.org/maps.git' on any engine; try ./dir"),
    ("maps: 'docker-image://Not/Good'", "'Not/Good' is not an image reference"),
    ("maps: nav", "images stand on each other: nav -> nav"),
    ("other: ../../maps", "warning: Dockerfile uses no 'other', so this changes nothing; try COPY --from=other in it"),
    ("stage: ../../maps", "Dockerfile has a stage of that name; try another name for one of the two"),
]


@pytest.mark.parametrize(("line", "said"), WRONG)
def test_what_no_context_is_is_told_at_its_place(tmp_path, line, said):
    dockerfile = f"FROM {BASE_IMAGE} AS stage\nFROM stage\nCOPY --from=maps / /maps/\n"
    loaded = tree(tmp_path, f"  additional_contexts:\n    {line}\n", dockerfile)
    found = [str(d) for d in loaded.diagnostics]
    assert any(said.replace("FOLDER", str(tmp_path)) in text for text in found), found
    assert any("nav.yaml:7:" in text or "Dockerfile:3:" in text for text in found), found


def test_layers_are_taken_from_images_alone(tmp_path):
    loaded = tree(tmp_path, "  cache_from: [a, 'type=gha']\n", f"FROM {BASE_IMAGE}\n")
    (found,) = loaded.errors
    assert str(found).endswith("from nothing else; try name:tag, or type=registry,ref=name:tag")
    assert (found.where.line, found.where.column) == (6, 19)
