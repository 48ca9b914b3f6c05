"""Software comes to the robot by a commit, and goes back by a revert (paper, Table I): built beside what runs, exactly
the services replaced whose images are other ones, and the images of before used again as they are."""

from __future__ import annotations

import re
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from commands import rorg
from common import BASE_IMAGE
from histories import entries
from image_trees import Heard
from robots import RealRobot, write_tree

from rorg.errors import EngineError
from rorg.images.order import LABEL_IMAGE
from rorg.images.references import references_for
from rorg.images.supply import Supplier
from rorg.manifest.load import load_or_raise
from rorg.model.units import stamp

RUNS = ["python3", "-S", "/app/program.py"]
PROGRAM = """import time
while True:
    time.sleep(60)
"""


def git(folder: Path, *words: str) -> str:
    who = ["-c", "user.name=robot", "-c", "user.email=robot@lab"]
    return subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True, text=True).stdout


def write_image(robot: RealRobot, name: str, parent: str, version: str) -> Path:
    """An image with /NAME.txt in it; what it is called, and from what it is made."""
    context = robot.tree.parent / "software" / name
    context.mkdir(parents=True, exist_ok=True)
    (context / "version.txt").write_text(f"{version}\n")
    (context / "program.py").write_text(PROGRAM)
    (context / "Dockerfile").write_text(
        f"FROM {parent}\nCOPY version.txt /{name}.txt\nCOPY program.py /app/program.py\n"
    )
    (robot.tree / "images").mkdir(parents=True, exist_ok=True)
    document = {
        "apiVersion": "rorg/v1",
        "kind": "Image",
        "metadata": {"name": name},
        "spec": {"context": f"../../software/{name}"},
    }
    (robot.tree / f"images/{name}.yaml").write_text(yaml.safe_dump(document))
    return context


@pytest.fixture(scope="module")
def engine_of_ours(dockerd):
    """Images stay from test to test, and go at the end."""
    yield
    import docker

    api = docker.APIClient(dockerd.host, version="auto")
    for row in api.images(filters={"label": LABEL_IMAGE}):
        for tag in row["RepoTags"]:
            if tag.partition(":")[0] in NAMES:
                api.remove_image(tag, force=True)


NAMES = ("mid", "camera", "map", "other")


@pytest.fixture
def robot(engine_of_ours, docker_robot):
    """base -> mid -> camera, mid -> map; and other, which stands on nothing of these. All of it is in git."""
    robot = docker_robot
    for name, parent in zip(NAMES, (BASE_IMAGE, "mid", "mid:latest", BASE_IMAGE), strict=True):
        write_image(robot, name, parent, "1")
    git(robot.tree.parent, "init", "-q")
    (robot.tree.parent / ".gitignore").write_text("state/\n")
    robot.declare({name: {"image": name, "command": RUNS, "always_on": True} for name in NAMES[1:]})
    git(robot.tree.parent, "add", "-A")
    git(robot.tree.parent, "commit", "-qm", "one")
    robot.wait(lambda: all(says(robot, n, n) == "1" for n in NAMES[1:]), 120)
    return robot


def running(robot: RealRobot, service: str):
    return next((c for c in robot.containers() if c.service == service and c.state == "running"), None)


def says(robot: RealRobot, service: str, of: str) -> str:
    """The version of an image's part in the container of a service that runs."""
    container = running(robot, service)
    if container is None:
        return ""
    try:
        return robot.engine.exec(container.id, ["sh", "-c", f"read v < /{of}.txt; echo $v"], 30.0)[1].decode().strip()
    except EngineError:  # it has just ended
        return ""


def ids(robot: RealRobot) -> dict[str, str]:
    """Of the containers that run."""
    return {c.service: c.id for c in robot.containers() if c.state == "running"}


def of_images(robot: RealRobot, outcome: str) -> list[str]:
    """Names of the images of which the journal tells this, in their order."""
    return [
        e["image"].partition(":")[0]
        for e in entries(robot.state.journal)
        if e.get("image") and e.get("outcome") == outcome
    ]


def test_a_commit_brings_version_2_and_a_revert_version_1(robot):
    before, made = ids(robot), len(of_images(robot, "built"))
    (robot.tree.parent / "software/camera/version.txt").write_text("2\n")
    git(robot.tree.parent, "commit", "-qam", "two")
    robot.wait(lambda: says(robot, "camera", "camera") == "2", 120)
    robot.settle()
    after = ids(robot)
    assert {n for n in before if before[n] != after[n]} == {"camera"}
    assert of_images(robot, "built")[made:] == ["camera"]
    git(robot.tree.parent, "revert", "--no-edit", "HEAD")
    robot.wait(lambda: says(robot, "camera", "camera") == "1", 120)
    robot.settle()
    assert of_images(robot, "built")[made:] == ["camera"], "a revert builds nothing"
    assert {n for n in after if after[n] != ids(robot)[n]} == {"camera"}


def test_a_parent_that_changed_replaces_what_descends_from_it(robot):
    before = ids(robot)
    (robot.tree.parent / "software/mid/version.txt").write_text("2\n")
    robot.wait(lambda: says(robot, "camera", "mid") == says(robot, "map", "mid") == "2", 120)
    robot.settle()
    after = ids(robot)
    assert {n for n in before if before[n] != after[n]} == {"camera", "map"}
    assert says(robot, "other", "other") == "1"


def test_a_build_that_fails_changes_nothing_that_runs(robot):
    before = ids(robot)
    dockerfile = robot.tree.parent / "software/mid/Dockerfile"
    text = dockerfile.read_text()
    dockerfile.write_text(text + "COPY nothing-here /x\n")
    (robot.tree.parent / "software/other/version.txt").write_text("2\n")
    robot.wait(lambda: says(robot, "other", "other") == "2", 120)
    robot.wait(lambda: "cannot be built" in robot.waits("camera") or "is not built" in robot.waits("camera"), 120)
    after = ids(robot)
    assert {n for n in before if before[n] != after[n]} == {"other"}
    assert set(of_images(robot, "failed")) == {"mid"}
    assert running(robot, "camera")
    dockerfile.write_text(text)
    robot.wait(lambda: not robot.waits("camera"), 60)
    assert ids(robot)["camera"] == before["camera"]


def test_what_is_active_keeps_its_image_until_it_is_ceased_where_the_policy_says_so(robot):
    policy = {"apiVersion": "rorg/v1", "kind": "Policy", "metadata": {"name": "default"}}
    policy["spec"] = {"updates": {"when": "when_ceased"}}
    (robot.tree / "policies/default.yaml").write_text(yaml.safe_dump(policy))
    robot.settle()
    before = ids(robot)
    (robot.tree.parent / "software/camera/version.txt").write_text("later\n")
    robot.wait(lambda: "takes effect when the service next idles" in robot.waits("camera"), 120)
    assert ids(robot) == before
    assert says(robot, "camera", "camera") == "1"
    robot.change(lambda document: replace(document, restarts={"camera": stamp(time.time())}))
    robot.wait(lambda: says(robot, "camera", "camera") == "later", 60)


def test_an_image_that_somebody_removed_is_built_again(robot):
    robot.stop()
    api = robot.engine.api()
    container = running(robot, "camera")
    reference = api.inspect_container(container.id)["Config"]["Image"]
    api.remove_container(container.id, force=True)
    api.remove_image(reference, force=True)
    robot.start()
    robot.wait(lambda: says(robot, "camera", "camera") == "1", 120)


def test_what_is_changed_while_it_is_built_is_no_image_of_what_it_was(dockerd, tmp_path):
    """Else a rollback would find another program than the one that was there."""
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    context = write_image(robot, "hasty", BASE_IMAGE, "1")
    write_tree(robot.tree, {"camera": {"image": "hasty"}})

    class Hasty(Heard):
        def began(self, order) -> None:
            (context / "version.txt").write_text("2\n")

    supplier = Supplier(robot.engine, robot.state, "test", jobs=1)
    references, catalog = references_for("docker", robot.state.path), load_or_raise(robot.tree)
    first = references.of(catalog)
    (result,) = [r for r in supplier.supply(catalog, first, ["hasty"], listener=Hasty()) if r.reference != BASE_IMAGE]
    assert (result.outcome, result.message) == ("failed", "its files changed while it was being built")
    assert robot.engine.missing_images(first.references.values()) == set(first.references.values())
    second = references.of(catalog)
    assert second.references != first.references
    assert all(r.good for r in supplier.supply(catalog, second, ["hasty"], listener=Heard()))
    supplier.make_builder().remove([*second.references.values(), "hasty"])
    robot.close()


def test_a_running_rorg_imports_nothing(docker_robot):
    """The command of an import runs on the machine, as whoever rorg is: a person says when."""
    robot = docker_robot
    (robot.tree / "images").mkdir(parents=True)
    marker = robot.tree / "ran"
    spec = {"import": ["touch", str(marker)]}
    document = {"apiVersion": "rorg/v1", "kind": "Image", "metadata": {"name": "root"}, "spec": spec}
    (robot.tree / "images/root.yaml").write_text(yaml.safe_dump(document))
    robot.declare({"camera": {"image": "root", "command": RUNS, "always_on": True}})
    robot.wait(lambda: "rorg build" in robot.waits("camera"), 60)
    assert not marker.exists()


def test_apply_builds_what_is_missing_before_it_stops_anything(robot):
    robot.stop()
    before = ids(robot)
    where = {"RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "docker"}
    (robot.tree.parent / "software/camera/version.txt").write_text("applied\n")
    shown = rorg("diff", str(robot.tree), code=1, **where).stdout
    assert re.search("camera .*image.*camera:[0-9a-f]{12} -> camera:[0-9a-f]{12}", shown), shown
    assert rorg("apply", str(robot.tree), "--yes", "--wait", **where).returncode == 0
    after = ids(robot)
    assert says(robot, "camera", "camera") == "applied"
    assert {n for n in before if before[n] != after[n]} == {"camera"}
    dockerfile = robot.tree.parent / "software/mid/Dockerfile"
    dockerfile.write_text(dockerfile.read_text() + "COPY nothing-here /x\n")
    told = rorg("apply", str(robot.tree), "--yes", "--wait", code=4, **where).stderr
    assert "mid failed" in told
    assert "COPY nothing-here /x" in told
    assert ids(robot) == after


def test_a_request_for_what_cannot_be_built_ends_at_once_and_says_why(dockerd, tmp_path):
    robot = RealRobot(tmp_path, "docker", dockerd.host, with_server=True)
    try:
        context = write_image(robot, "never", BASE_IMAGE, "1")
        (context / "Dockerfile").write_text(f"FROM {BASE_IMAGE}\nCOPY nothing-here /x\n")
        robot.declare({"camera": {"image": "never", "command": RUNS}})
        robot.wait(lambda: robot.socket() and Path(robot.socket()).exists(), 60)
        where = {"RORG_SOCKET": robot.socket()}
        told = rorg("request", "camera", "--wait", "--timeout", "100s", code=4, **where)
        assert "cannot be built at" in told.stderr
        assert "COPY nothing-here" in told.stderr
        assert "cannot be built" in rorg("get", "camera", **where).stdout
    finally:
        robot.close()
