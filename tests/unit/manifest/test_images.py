"""Images as they are declared: names, what their Dockerfiles use, and what is wrong with that. Mistakes that refuse a
tree are in cases/broken."""

from __future__ import annotations

from pathlib import Path

import pytest
from image_manifests import images

from rorg.manifest.load import Loaded, load
from rorg.model.image_names import LONGEST, check_name, stems


def told(folder: Path, loaded: Loaded) -> list[str]:
    return [str(d).replace(f"{folder}/", "") for d in loaded.diagnostics]


NAMES = ["base", "b", "a.b", "a__b", "a--b", "lab/base", "lab/base:1.2", "lab:5000/a/b", "robot.lab:5000/base:v1_2-x"]


@pytest.mark.parametrize("name", NAMES)
def test_an_image_is_named_as_engines_take_it(name, tmp_path):
    loaded = images(tmp_path, {name: "FROM scratch"})
    assert loaded.diagnostics == ()
    assert list(loaded.catalog.images) == [name]


@pytest.mark.parametrize(
    "name",
    ["", "/a", "a/", "a//b", "..", "a..b", "a/../b", "Base", "a:B", "a:", ":1", "a:1:2", "a b", "a\n", "é", "-a", "a-"]
    + ["a:latest", "lab/a:latest", "docker.io/a", "docker.io/library/a", f"a@sha256:{'0' * 64}", "a" * (LONGEST + 1)]
    + ["a:" + "1" * 65, "lab:500000/a"],
)
def test_what_an_image_cannot_be_called(name):
    with pytest.raises(ValueError, match=r"write"):
        check_name(name)


def test_a_file_may_be_called_after_a_part_of_the_name():
    assert stems("nav") == {"nav"}
    assert stems("lab/nav:1.2") == {"nav", "nav-1.2", "nav_1.2", "lab-nav-1.2", "lab_nav_1.2"}


def test_a_file_of_another_name_is_told(tmp_path):
    images(tmp_path, {"lab/nav:1.2": "FROM scratch"})
    (tmp_path / "tree/images/lab-nav-1.2.yaml").rename(tmp_path / "tree/images/nav-1.3.yaml")
    assert told(tmp_path, load(tmp_path / "tree")) == [
        "tree/images/nav-1.3.yaml:3:18: warning: the Image 'lab/nav:1.2' is in a file called 'nav-1.3.yaml'; "
        "try 'nav-1.3', or rename the file"
    ]


def test_an_image_stands_on_all_that_its_stages_use_up_to_the_target(tmp_path):
    text = """ARG BASE=standin
FROM ${BASE}:1 AS build
RUN --mount=from=tools,target=/t make
FROM zbase:latest AS Runtime
COPY --from=build /a /a
COPY --from=lab/maps:2 /m /m
FROM later
"""
    more = "  target: runtime\n  platform: linux/arm64/v8\n  args: {BASE: lab/other}\n"
    image = images(tmp_path, {"robot": text}, robot=more).catalog.images["robot"]
    assert image.bases == ("lab/other:1", "tools", "zbase:latest", "lab/maps:2")
    assert (image.target, image.platform) == ("runtime", "linux/arm64/v8")


def test_arguments_that_change_nothing_are_told(tmp_path):
    text = "ARG BASE=a\nFROM $BASE\nARG COLOUR=red SIZE\n"
    args = "  args: {BASE: b, COLOR: blue, SIZE: 1, http_proxy: x, BUILDKIT_INLINE_CACHE: 1, TARGETARCH: x}\n"
    assert told(tmp_path, images(tmp_path, {"robot": text}, robot=args)) == [
        "tree/images/robot.yaml:6:19: warning: Dockerfile has no ARG COLOR, so this changes nothing; try 'COLOUR'"
    ]


def test_a_parent_that_is_almost_an_image_is_told_and_others_are_not(tmp_path):
    dockerfiles = {
        "ros_deploy_base": "FROM ubuntu",
        "one": "# parent\n\nFROM ros_deploy_bse",
        "two": "FROM ros_deploy_bse:1\nCOPY --from=lab/ros_deploy_bse / /\nCOPY --from=ros_deploy_base / /",
    }
    assert told(tmp_path, images(tmp_path, dockerfiles)) == [
        "one/Dockerfile:3:1: warning: no Image is called 'ros_deploy_bse', so it is pulled; try 'ros_deploy_base'"
    ]


def test_a_dockerfile_that_changes_is_read_anew(tmp_path):
    found = []
    before = images(tmp_path, {"robot": "FROM a"})
    (tmp_path / "robot/Dockerfile").write_text("FROM b")
    after = load(tmp_path / "tree", on_inputs=found.append)
    assert after.catalog.images["robot"].bases == ("b",)
    assert after.catalog.fingerprint != before.catalog.fingerprint
    assert {path.resolve() for path in found[0].files} == {tmp_path / "robot/Dockerfile"}


def test_a_service_may_name_an_image_with_its_latest_tag(tmp_path):
    """An Image brings programs along on the process engine, so nothing is said of one that this machine lacks."""
    services = {"camera": {"image": "zbase:latest", "command": ["no-such-program"]}}
    images(tmp_path, {"zbase": "FROM scratch"}, services)
    assert load(tmp_path / "tree", engine="process").diagnostics == ()
