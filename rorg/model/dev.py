"""Containers to develop in (the paper's Section III: the same image on the robot and on the developer's desk)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

LABEL_DEV = "rorg.io/dev"
"""The instance of the robot. They never carry rorg.io/owner: the loop would take them for a service's."""
LABEL_OF = "rorg.io/dev-of"
LABEL_SPEC = "rorg.io/dev-spec"
LABEL_IMAGE = "rorg.io/dev-image"
LABEL_WORKSPACE = "rorg.io/dev-workspace"
LABEL_USER = "rorg.io/dev-user"
LABEL_WITH = "rorg.io/dev-with"


@dataclass(frozen=True, slots=True)
class DevContainer:
    """One that is there."""

    id: str
    name: str
    state: str
    """The engine's word, as of a service's container."""
    of: str
    """NAME of a service, or image/NAME."""
    digest: str = ""
    """Of what the manifests said when it was made, without the image."""
    image: str = ""
    """Id of the image that it was made from."""
    workspace: str = ""
    user: str = ""
    """UID:GID of whoever develops in it."""
    extras: tuple[str, ...] = ()
    """Of x11 and gpu, what it has."""


def from_row(container: str, name: str, state: str, labels: Mapping[str, str]) -> DevContainer:
    """One by the engine's list."""
    return DevContainer(
        container,
        name,
        state,
        of=labels.get(LABEL_OF, ""),
        digest=labels.get(LABEL_SPEC, ""),
        image=labels.get(LABEL_IMAGE, ""),
        workspace=labels.get(LABEL_WORKSPACE, ""),
        user=labels.get(LABEL_USER, ""),
        extras=tuple(filter(None, labels.get(LABEL_WITH, "").split(","))),
    )
