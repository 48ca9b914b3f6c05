"""Dev containers (Section III of the paper: the same image on the robot and on the developer's desk)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

LABEL_DEV = "rorg.io/dev"
"""The instance of the robot. Dev containers never have rorg.io/owner: the loop would take them for a service's."""
LABEL_OF = "rorg.io/dev-of"
LABEL_SPEC = "rorg.io/dev-spec"
LABEL_IMAGE = "rorg.io/dev-image"
LABEL_WORKSPACE = "rorg.io/dev-workspace"
LABEL_USER = "rorg.io/dev-user"
LABEL_WITH = "rorg.io/dev-with"


@dataclass(frozen=True, slots=True)
class DevContainer:
    """An existing dev container."""

    id: str
    name: str
    state: str
    """As the engine reports it for any container."""
    of: str
    """NAME of a service, or image/NAME."""
    digest: str = ""
    """Digest of the manifests' declaration when it was created, without the image."""
    image: str = ""
    """Id of its image."""
    workspace: str = ""
    user: str = ""
    """UID:GID of the developer."""
    extras: tuple[str, ...] = ()
    """The extras that it has: x11, gpu."""


def from_row(container: str, name: str, state: str, labels: Mapping[str, str]) -> DevContainer:
    """Reads a dev container from a row of the engine's list."""
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
