"""A Compose project as a robot: its services under a common profile that adds nothing, so that rorg creates what
Compose creates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from rorg.compose.project import Project
from rorg.importing.compose_environment import taken
from rorg.importing.compose_images import images
from rorg.importing.compose_objects import groups, networks, requests, volumes
from rorg.importing.compose_services import services
from rorg.importing.compose_work import Work
from rorg.importing.manifests import Imported, Made

COMMON = Made(
    "Profile",
    "common",
    {},
    (
        "Adds nothing to what a service says, as Compose does. Without this file rorg gives every container",
        "network_mode: host, an init process, no-new-privileges and a rotation of its log; see `rorg explain`.",
    ),
)


def from_compose(
    project: Project,
    tree: Path,
    top: Path,
    environment: Mapping[str, str],
    read: Callable[[Path], str | None],
) -> Imported:
    """The manifests of a project. `tree`: where they will lie; `top`: what is below it is named relative to them (both
    absolute); `environment`: what secrets and configs may take their content from; `read`: the text of a file, None for
    one that is not there. Everything that cannot be carried over is told at once."""
    work = Work(project, tree, top, environment, read)
    built, used = images(work)
    made = [COMMON, *services(work, used), *built, *networks(work), *volumes(work), *groups(work), *requests(work)]
    found = [*work.found, *taken(work)]
    return Imported(tuple(made), dict(work.files), frozenset(work.private), tuple(sorted(dict.fromkeys(found))))
