"""Imports launch files: one of ROS 1 as one Service, one of ROS 2 as a Service for each program that it starts."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic, Where
from rorg.tools.importing.launch_packages import Read, package_of
from rorg.tools.importing.launch_version import ROS2_SUFFIXES, version
from rorg.tools.importing.launch_xml import read_launch
from rorg.tools.importing.manifests import Imported
from rorg.tools.importing.ros1_launch import from_ros1
from rorg.tools.importing.ros2_import import from_ros2


def from_roslaunch(
    path: Path,
    read: Read,
    arguments: Mapping[str, str],
    image: str = "",
    with_master: bool = True,
    *,
    ros: int = 0,
    environment: Mapping[str, str] | None = None,
    skip: bool = False,
) -> Imported:
    """The manifests of a launch file. `ros`: 1 or 2, or 0 to tell by the file; `environment`: variables for
    $(env NAME); `skip`: leave out what cannot be carried over. The master is only for ROS 1."""
    path = Path(os.path.abspath(path))
    package = package_of(path, read)
    known = ros or _version(path, read, package.ros)
    if isinstance(known, Diagnostic):
        return Imported(diagnostics=(known,))
    if known == 2:
        return from_ros2(path, package, read, arguments, image, environment=environment or {}, skip=skip)
    return from_ros1(path, package, read, arguments, image, with_master)


def _version(path: Path, read: Read, package: int) -> int | Diagnostic:
    if path.suffix in ROS2_SUFFIXES:
        return 2
    try:
        top = read_launch(path, read(path))
    except OSError as error:
        return Diagnostic(Where(str(path)), f"cannot read {path}: {error.strerror}", "an existing file")
    except TooMuch as bound:
        return bound.diagnostic
    return top if isinstance(top, Diagnostic) else version(path, top, package)
