"""Manifests that are links to other files of the tree."""

from __future__ import annotations

import subprocess

import pytest
import yaml
from robots import write_tree

from rorg.api.manifest_change import ManifestChange, digest, recover
from rorg.daemon.tree import Tree
from rorg.manifest.load import load

SPEC = {"image": "robot", "mounts": ["./config:/etc/arm"], "container": {"env_file": "arm.env"}}


@pytest.fixture
def tree(tmp_path):
    """The manifest of the arm is shared: it lies with all that it names in a folder of its own."""
    found = write_tree(tmp_path / "tree", {"camera": {}})
    shared = found / "shared/arm"
    (shared / "config").mkdir(parents=True)
    (shared / "arm.env").write_text("SPEED=2\n")
    manifest = {"apiVersion": "rorg/v1", "kind": "Service", "metadata": {"name": "arm"}, "spec": SPEC}
    (shared / "arm.yaml").write_text(yaml.safe_dump(manifest))
    (found / "services/arm.yaml").symlink_to("../shared/arm/arm.yaml")
    return found


def test_its_relative_paths_begin_beside_the_file_that_it_leads_to(tree):
    found = load(tree)
    assert [str(d) for d in found.diagnostics] == []
    spec = found.catalog.services["arm"].spec
    assert spec["environment"]["SPEED"] == "2"
    assert f"{tree}/shared/arm/config:/etc/arm:ro" in spec["volumes"]


def test_one_that_leads_out_of_the_tree_is_refused(tree):
    (tree.parent / "arm.yaml").write_text((tree / "services/arm.yaml").read_text())
    (tree / "services/arm.yaml").unlink()
    (tree / "services/arm.yaml").symlink_to("../../arm.yaml")
    assert "services/arm.yaml:1:1: error: cannot be read: it is a link that leads out" in str(load(tree).diagnostics[0])


def test_where_it_leads_to_is_watched(tree):
    found = Tree(tree)
    found.read_now()
    assert tree / "shared/arm" in found.folders()
    before = found.stamp()
    (tree / "shared/arm/arm.yaml").write_text("x")
    assert found.stamp() != before


def test_a_change_is_written_where_it_leads_to(tree):
    subprocess.run(["git", "init", "--quiet", tree], check=True)
    link, place = tree / "services/arm.yaml", tree / "shared/arm/arm.yaml"
    text = place.read_text() + "  priority: 3\n"
    change = ManifestChange(
        "services/arm.yaml", digest(place.read_bytes()), digest(text.encode()), "Change the arm", "Anna"
    )
    change.carry_out(tree, tree.parent / "note", text)
    assert link.is_symlink()
    assert place.read_text() == text
    shown = ["git", "-C", tree, "-c", "safe.directory=*", "show", "--name-only", "--format=%s"]
    assert subprocess.check_output(shown, text=True).split("\n")[2] == "shared/arm/arm.yaml"
    gone = ManifestChange("services/arm.yaml", digest(text.encode()), None, "No arm", "Anna")
    gone.carry_out(tree, tree.parent / "note", None)
    assert not link.is_symlink()
    assert place.exists()
    assert recover(tree, tree.parent / "note") is None
