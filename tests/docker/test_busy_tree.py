"""A tree in which files are written all the time: logs, bags, maps. Manifests count whatever else is going on."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from common import wait_for
from robots import RealRobot, write_tree

from rorg.daemon.tree import Tree
from rorg.host.watch import Watcher
from rorg.images.records import Built, Records
from rorg.images.references import References

WRITER = """
import sys, time
with open(sys.argv[1], "a") as file:
    while True:
        file.write("# line\\n"); file.flush(); time.sleep(0.001)
"""
IDLE = {f"idle{n}": {} for n in range(20)}
"""A tree that takes a while to read."""


@contextlib.contextmanager
def busy(path: Path):
    """Another program writes a file every millisecond or two, as a logger does."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = subprocess.Popen([sys.executable, "-S", "-c", WRITER, str(path)])
    try:
        wait_for(lambda: path.exists() and path.stat().st_size)
        yield
    finally:
        writer.kill()
        writer.wait()


@pytest.mark.parametrize("place", ["bags/now.bag", "services/map/track.log", "logs/now.yaml"])
def test_manifests_load_beside_a_file_that_is_written_all_the_time(dockerd, tmp_path, place):
    """Below the tree, in a folder that a service mounts, and in a YAML file that is no manifest."""
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    (robot.tree / "services/map").mkdir(parents=True)
    camera = {"always_on": True, "mounts": ["./map:/map"], "on_change": "none"}
    try:
        with busy(robot.tree / place):
            robot.declare({"camera": camera, **IDLE})
            robot.wait(lambda: robot.active() == {"camera"})
            before = robot.engine.api().inspect_container("camera")
            began = time.monotonic()
            robot.declare({"camera": camera, "mapper": {"always_on": True}, **IDLE})
            robot.wait(lambda: robot.active() == {"camera", "mapper"})
            assert time.monotonic() - began < 30.0
            after = robot.engine.api().inspect_container("camera")
            assert (after["Id"], after["State"]["StartedAt"]) == (before["Id"], before["State"]["StartedAt"])
    finally:
        robot.close()


@pytest.mark.slow
def test_a_manifest_that_is_written_all_the_time_does_not_hold_back_the_others(tmp_path):
    tree = Tree(write_tree(tmp_path / "tree", {"camera": {}, **IDLE}))
    assert tree.read()[0]
    with busy(tmp_path / "tree/services/camera.yaml"):
        write_tree_beside(tmp_path / "tree", "mapper")
        began = time.monotonic()
        wait_for(lambda: tree.read() and ("mapper" in tree.desired.catalog.services or tree.errors))
        assert time.monotonic() - began < 30.0


def write_tree_beside(root: Path, name: str) -> None:
    text = (root / "services/camera.yaml").read_text().split("# ")[0].replace("name: camera", f"name: {name}")
    (root / f"services/{name}.yaml").write_text(text)


def test_what_is_read_beside_the_manifests_counts(tmp_path):
    """env_file, a mount and a Dockerfile that are missing refuse the tree; that they come is seen."""
    camera = {"container": {"env_file": "camera.env"}, "mounts": ["./map:/map"]}
    root = write_tree(tmp_path / "tree", {"camera": camera})
    (root / "images").mkdir()
    (root / "images/eye.yaml").write_text(
        "apiVersion: rorg/v1\nkind: Image\nmetadata: {name: eye}\nspec: {context: eye}\n"
    )
    tree = Tree(root)
    tree.read()
    assert len(tree.errors) == 3
    (root / "services/camera.env").write_text("RATE=10\n")
    assert tree.read() == (True, False)
    (root / "services/map").mkdir()
    wait_for(lambda: tree.read() == (True, False))
    (root / "images/eye").mkdir()
    (root / "images/eye/Dockerfile").write_text("FROM scratch\n")
    wait_for(lambda: tree.read()[0])
    assert not tree.errors
    assert tree.desired.catalog.services["camera"].spec["environment"]["RATE"] == "10"
    (root / "services/camera.env").write_text("RATE=200\n")
    assert tree.read() == (True, False)
    assert tree.desired.catalog.services["camera"].spec["environment"]["RATE"] == "200"
    before = tree.stamp()
    (root / "services/map/floor.pgm").write_text("x")
    assert tree.stamp() != before
    before = tree.stamp()
    (root / "images/eye/main.py").write_text("x")
    (root / "notes").mkdir()
    (root / "notes/today.txt").write_text("x")
    assert tree.stamp() == before, "where an image is no more than a name, what it is built from does not count"


def test_a_change_that_comes_while_the_tree_is_read_is_not_lost(tmp_path):
    robot = RealRobot(tmp_path, "process", None)
    robot.declare({"camera": {}})
    try:
        robot.settle()
        read, left = robot.loop.tree.read, [True]

        def read_and_change() -> tuple[bool, bool]:
            found = read()
            if left:
                left.clear()
                write_tree(robot.tree, {"camera": {}, "late": {}})
                robot.loop.wakes.files_changed()
            return found

        next(t for t in robot.loop.threads if isinstance(t, Watcher)).stop()
        robot.loop.tree.read = read_and_change
        robot.loop.wakes.files_changed()
        robot.wait(lambda: "late" in robot.loop.tree.desired.catalog.services)
    finally:
        robot.close()


def tree_of_images(root: Path, spec: str) -> Tree:
    """It has been read; its one Image is called eye."""
    (root / "images").mkdir()
    (root / "images/eye.yaml").write_text(
        f"apiVersion: rorg/v1\nkind: Image\nmetadata: {{name: eye}}\nspec: {{{spec}}}\n"
    )
    tree = Tree(root, references=References(Records(root.parent)))
    tree.read()
    return tree


def test_what_images_are_built_from_counts(tmp_path):
    """Also beside the tree, whatever its names begin with; but not git's own files."""
    root = write_tree(tmp_path / "tree", {"camera": {"image": "eye"}})
    context = tmp_path / "eye"
    (context / ".git").mkdir(parents=True)
    (context / ".config").mkdir()
    (context / "Dockerfile").write_text("FROM scratch\n")
    tree = tree_of_images(root, "context: ../../eye")
    first = tree.desired.catalog.services["camera"].spec["image"]
    assert re.fullmatch("eye:[0-9a-f]{12}", first)
    assert context in tree.folders()
    assert context / ".git" not in tree.folders()
    (context / ".git/HEAD").write_text("x")
    assert tree.read() == (False, False)
    (context / ".config/rate").write_text("10")
    wait_for(lambda: tree.read()[0])
    changed = tree.desired.catalog.services["camera"].spec["image"]
    assert changed != first
    (context / ".config/rate").unlink()
    (context / ".config").rmdir()
    wait_for(lambda: tree.read()[0])
    (context / ".config").mkdir()
    wait_for(lambda: tree.read()[0])
    assert tree.desired.catalog.services["camera"].spec["image"] == first


def test_an_image_that_was_built_anew_from_the_same_files_is_another_one(tmp_path):
    root = write_tree(tmp_path / "tree", {"camera": {"image": "eye:latest"}})
    tree = tree_of_images(root, "import: 'true'")
    desired, records = tree.desired, tree.references.records
    (identity,) = tree.images.identities.values()
    assert tree.read() == (False, False)
    records.note({identity: Built("eye", tree.images.references["eye"])})
    assert tree.read() == (False, False)
    assert tree.desired is desired
    records.note({identity: Built("eye", "eye:other")})
    assert tree.read() == (True, False)
    assert tree.desired.catalog.services["camera"].spec["image"] == "eye:other"
    assert tree.desired.catalog.fingerprint != desired.catalog.fingerprint
    (root / "services/camera.yaml").write_text("nonsense")
    wait_for(lambda: tree.read()[0])
    errors = tree.errors
    records.note({identity: Built("eye", "eye:third")})
    assert tree.read() == (True, False)
    assert tree.desired.catalog.services["camera"].spec["image"] == "eye:third"
    assert tree.errors == errors != (), "what is wrong with the tree stays so"


def test_a_context_that_nobody_means_to_build_from_refuses_the_tree(tmp_path):
    """It would be read whole in the pass of the loop; the last good tree stays in force."""
    root = write_tree(tmp_path / "tree", {"camera": {"image": "eye"}})
    (tmp_path / "eye").mkdir()
    (tmp_path / "eye/Dockerfile").write_text("FROM scratch\n")
    tree = tree_of_images(root, "context: ../../eye")
    assert not tree.errors
    desired = tree.desired
    with (tmp_path / "eye/bag").open("wb") as bag:
        bag.truncate(3 << 30)
    wait_for(lambda: tree.read()[0])
    assert "more than 100,000 files or 2 GiB; try a .dockerignore" in str(tree.errors[0])
    assert tree.desired is desired
    (tmp_path / "eye/.dockerignore").write_text("bag\n")
    wait_for(lambda: tree.read()[0])
    assert not tree.errors


def test_a_commit_that_comes_after_the_reading_is_not_taken_for_what_was_read(tmp_path):
    """Otherwise history would say of old manifests that they are the new commit, and `rollback` would trust that."""
    root = write_tree(tmp_path / "tree", {"camera": {}})
    git = ["git", "-C", str(root), "-c", "user.name=me", "-c", "user.email=me@robot"]
    commit = [*git, "commit", "--quiet", "--all", "--message"]
    subprocess.run([*git, "init", "--quiet"], check=True)
    subprocess.run([*git, "add", "."], check=True)
    subprocess.run([*commit, "first"], check=True)
    tree = Tree(root)
    tree.read_now()
    write_tree(root, {"camera": {"always_on": True}})
    subprocess.run([*commit, "second"], check=True)
    assert tree.commit
    assert tree.overtaken
    wait_for(lambda: tree.read()[0], 10, "the tree to be read again")
    assert tree.commit
    assert not tree.overtaken
    assert tree.desired.catalog.services["camera"].always_on
