"""Workspaces of ROS that an image has built, and mounts that hide them."""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache

from rorg.manifest.dockerfile_lines import DockerfileError, script
from rorg.manifest.images import read_dockerfile
from rorg.manifest.validation.robot import Finding, Robot
from rorg.manifest.validation.texts import text_of, text_of_dockerfile
from rorg.model.image_names import declared

BUILDS = re.compile(r"\b(colcon\s+build|catkin_make(_isolated)?|catkin\s+build)\b")
ELSEWHERE = re.compile(r"--install-base|--install-space|CMAKE_INSTALL_PREFIX")
"""Options that install into another directory than that of the workspace."""
CD = re.compile(r"\bcd\s+([^\s;&|]+)")
RESULTS = ("install", "devel")
"""Directories that a build makes in its workspace."""


@lru_cache(maxsize=256)
def built(text: str, target: str = "") -> frozenset[str]:
    """The workspaces that a stage of a Dockerfile builds; the last stage if `target` is empty. Paths with variables are
    unknown and left out."""
    stages = dict[str, frozenset[str]]()
    workspaces, name, directory = frozenset[str](), "", "/"
    for instruction in script(text).instructions:
        said = instruction.arguments.text.strip()
        if instruction.name == "FROM":
            if target and name == target.lower():
                return workspaces
            base, *alias = said.lower().split() or [""]
            workspaces, directory = stages.get(base, frozenset()), "/"
            name = alias[1] if len(alias) == 2 else ""
        elif instruction.name == "WORKDIR":
            directory = posixpath.join(directory, said.strip("\"'"))
        elif instruction.name == "RUN" and (build := BUILDS.search(said)) and not ELSEWHERE.search(said):
            path = directory
            for moved in CD.findall(said[: build.start()]):
                path = posixpath.join(path, moved.strip("\"'"))
            workspaces |= set() if re.search("[$~]", path) else {posixpath.normpath(path)}
        stages[name] = workspaces
    return workspaces


def _hidden(robot: Robot) -> Iterator[Finding]:
    """Mounts of directories without a build, over a workspace that the image has built."""
    for subject in robot.subjects:
        name = declared(str(subject.options.get("image") or ""), robot.catalog.images)
        mounts = [m for m in subject.mounts if m.path]
        if not name or not mounts or BUILDS.search(text_of(subject)):
            continue
        for workspace in sorted(_workspaces(robot, name)):
            for mount in (m for m in mounts if f"{workspace}/".startswith(f"{m.target.rstrip('/')}/")):
                inside = mount.path + workspace.removeprefix(mount.target.rstrip("/"))
                if not any(os.path.exists(posixpath.join(inside, result)) for result in RESULTS):
                    message = f"the mount hides {workspace}, where '{name}' has built its packages"
                    yield Finding("mount-over-workspace", subject.volume(mount), message, f"{workspace}/src")


def _workspaces(robot: Robot, name: str) -> frozenset[str]:
    """The workspaces in an Image of the tree, by its Dockerfile and those of its bases."""
    workspaces, seen = frozenset[str](), set[str]()
    while name and name not in seen:
        seen.add(name)
        image = robot.catalog.images[name]
        text, name = text_of_dockerfile(image), ""
        with suppress(DockerfileError):
            workspaces |= built(text, image.target)
            name = declared(read_dockerfile(text, image).programs.base, robot.catalog.images)
    return workspaces


CHECKS = (_hidden,)
