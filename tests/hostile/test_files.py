"""Odd files in a tree of manifests: whoever may commit stops nothing by them, and gets to see nothing by them."""

from __future__ import annotations

import contextlib
import os
import subprocess
from pathlib import Path

import pytest
from robots import RealRobot, write_tree

from rorg.host.git import revision
from rorg.images.docker import dockerfile_of
from rorg.images.order import Order
from rorg.manifest.files import MOST, read_text
from rorg.manifest.load import load
from rorg.model.catalog import Image

SECRET = "root:$6$kept.to.itself"


def pipe(path):
    os.mkfifo(path)


def link_to(target):
    return lambda path: path.symlink_to(target)


def huge(path):
    with path.open("wb") as file:
        file.truncate(MOST + 1)


def binary(path):
    path.write_bytes(bytes(range(256)) * 8)


ODD = {
    "a pipe": pipe,
    "a link to a device without end": link_to("/dev/zero"),
    "a link to the kernel's log": link_to("/proc/kmsg"),
    "a link to a terminal": link_to("/dev/tty"),
    "a link out of the tree": link_to("../../secret"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "a file of more than 4 MiB": huge,
    "a binary file": binary,
}


@pytest.fixture
def tree(tmp_path):
    (tmp_path / "secret").write_text(f"{SECRET}\n")
    return write_tree(tmp_path / "tree", {"camera": {}})


@pytest.mark.parametrize("make", ODD.values(), ids=ODD)
def test_an_odd_manifest_is_an_error_with_its_place(tree, make):
    make(tree / "services" / "odd.yaml")
    found = load(tree)
    assert any(str(tree / "services" / "odd.yaml") in str(d) for d in found.errors)
    assert SECRET not in "".join(map(str, found.diagnostics))


@pytest.mark.parametrize("make", ODD.values(), ids=ODD)
def test_odd_files_that_are_not_read_do_no_harm(tree, make):
    (tree / "notes").mkdir()
    make(tree / "notes" / "odd.yaml")
    found = load(tree)
    assert found.catalog is not None
    assert SECRET not in "".join(map(str, found.diagnostics))


@pytest.mark.parametrize(
    "make", [m for n, m in ODD.items() if n != "a binary file"], ids=[n for n in ODD if n != "a binary file"]
)
@pytest.mark.parametrize("option", ["env_file", "security_opt"])
def test_an_odd_file_that_a_service_names_is_an_error_at_its_place(tree, make, option):
    make(tree / "services" / "odd")
    value = ["odd"] if option == "env_file" else ["seccomp=odd"]
    write_tree(tree, {"camera": {"container": {option: value}}})
    found = load(tree)
    assert [d for d in found.errors if "camera.yaml" in str(d) and "odd" in str(d)]
    assert SECRET not in "".join(map(str, found.diagnostics))


@pytest.mark.parametrize("make", [pipe, link_to("../../secret"), huge], ids=["pipe", "link", "huge"])
def test_an_odd_dockerfile_is_an_error(tmp_path, make):
    (tmp_path / "secret").write_text(SECRET)
    context = tmp_path / "tree" / "image"
    context.mkdir(parents=True)
    make(context / "Dockerfile")
    image = Image("odd", str(context), "Dockerfile", {}, None, str(context))
    with pytest.raises(OSError, match="Dockerfile") as caught:
        dockerfile_of(Order("odd", image), image, True)
    assert SECRET not in str(caught.value)


def test_links_within_the_tree_and_paths_that_say_where_they_lead_are_read(tmp_path):
    tree = tmp_path / "tree"
    (tree / "parts").mkdir(parents=True)
    (tree / "parts" / "real").write_text("within")
    (tmp_path / "beside").write_text("beside")
    (tree / "link").symlink_to("parts/real")
    (tmp_path / "way").symlink_to(tree)
    assert read_text(tree / "link", tree) == "within"
    assert read_text(tmp_path / "way" / "link", tmp_path / "way") == "within"
    assert read_text(tree / ".." / "beside", tree) == "beside"


def test_a_repository_within_the_tree_executes_nothing(tree, tmp_path):
    """Its configuration would: git takes a directory that looks like a repository for one."""
    told = tmp_path / "told"
    git = ["git", "-c", "init.defaultBranch=main", "-c", "user.name=x", "-c", "user.email=x@x"]
    subprocess.run([*git, "init", "-q", str(tree / "seed")], check=True)
    (tree / "seed" / "file").touch()
    subprocess.run([*git, "-C", str(tree / "seed"), "add", "file"], check=True)
    subprocess.run([*git, "-C", str(tree / "seed"), "commit", "-q", "-m", "x"], check=True)
    for path in (tree / "seed" / ".git").iterdir():
        path.rename(tree / path.name)
    config = (
        "repositoryformatversion = 0",
        "bare = false",
        f"worktree = {tree}",
        f"fsmonitor = touch {told}; false",
    )
    (tree / "config").write_text("\n\t".join(("[core]", *config)) + "\n")
    naive = {"PATH": os.environ["PATH"], "HOME": str(tmp_path)}
    subprocess.run(["git", "-C", str(tree), "status"], env=naive, capture_output=True)
    assert told.exists(), "it is a trap for a git that is not told otherwise"
    told.unlink()
    revision(tree)
    assert not told.exists()


def watches() -> int:
    """Of this process, by the kernel's word (inotify in /proc/self/fdinfo)."""
    found = 0
    for name in os.listdir("/proc/self/fdinfo"):
        with contextlib.suppress(OSError):
            found += Path("/proc/self/fdinfo", name).read_text().count("inotify wd:")
    return found


def test_a_link_to_everything_costs_no_watches_and_hides_no_change(tmp_path):
    everything = tmp_path / "everything"
    for n in range(300):
        (everything / f"d{n}").mkdir(parents=True)
    robot, before = RealRobot(tmp_path, "process", ""), watches()
    try:
        write_tree(robot.tree, {"camera": {"always_on": True}})
        (robot.tree / "parts").symlink_to(everything)
        robot.declare({"camera": {"always_on": True}})
        robot.wait(lambda: "camera" in robot.active())
        (robot.tree / "services" / "parts").symlink_to("/")
        robot.declare({"camera": {"always_on": True}, "lidar": {"always_on": True}})
        robot.wait(lambda: {"camera", "lidar"} <= robot.active())
        assert watches() - before < 30
        write_tree(robot.tree, {"radar": {"always_on": True}})
        robot.wait(lambda: "radar" in robot.active())
    finally:
        robot.close()


def test_the_loop_goes_on_beside_all_of_them(tmp_path):
    robot = RealRobot(tmp_path, "process", "")
    try:
        robot.declare({"camera": {"always_on": True}})
        robot.wait(lambda: "camera" in robot.active())
        (tmp_path / "secret").write_text(SECRET)
        for index, make in enumerate(ODD.values()):
            make(robot.tree / "services" / f"odd{index}.yaml")
        robot.loop.wakes.files_changed()
        robot.wait(lambda: any("manifests refused" in line for line in robot.log()))
        passes = robot.loop.passes
        robot.kill("camera")
        robot.wait(lambda: robot.loop.passes > passes and "camera" in robot.active())
        assert SECRET not in "".join(robot.log())
        for index in range(len(ODD)):
            (robot.tree / "services" / f"odd{index}.yaml").unlink()
        robot.declare({"camera": {"always_on": True}, "lidar": {"always_on": True}})
        robot.wait(lambda: {"camera", "lidar"} <= robot.active())
    finally:
        robot.close()
