"""Which of rorg's images are kept, why, and how much disk space they take."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rorg.images.order import LABEL_BUILDER, LABEL_IMAGE
from rorg.model.image_names import plain
from rorg.model.units import counted


@dataclass(frozen=True, slots=True)
class Kept:
    """One of rorg's images on the engine's machine. Sizes are in bytes."""

    name: str
    """The Image of the tree that it was built from."""
    references: tuple[str, ...]
    """All of its names on the engine."""
    id: str
    created: float
    """Seconds since the epoch."""
    size: int
    shared: int
    """The part of its size that other images also use."""
    reasons: tuple[str, ...]
    """Why it is kept: it is in force, a revision used it, containers use it. Empty: it may be removed."""

    @property
    def freed(self) -> int:
        """Bytes that its removal is certain to free."""
        return 0 if self.reasons else self.size - self.shared

    def as_json(self) -> dict[str, Any]:
        fields = asdict(self)
        reasons = fields.pop("reasons")
        return {**fields, "references": list(self.references), "kept_for": list(reasons)}


def own_images(
    rows: Iterable[Mapping[str, Any]],
    owner: str,
    in_force: Collection[str],
    revisions: Sequence[Collection[str]],
    keep: int,
) -> list[Kept]:
    """Images that this instance built, by name, newest first. `rows`: the engine's report of disk usage; `in_force`:
    references that the tree declares; `revisions`: references of earlier states of the manifests, latest first, of
    which `keep` count."""
    images = []
    for row in rows:
        labels = row.get("Labels") or {}
        if labels.get(LABEL_BUILDER) == owner and LABEL_IMAGE in labels:
            tags = tuple(sorted(row.get("RepoTags") or ()))
            reasons = _reasons({plain(t) for t in tags}, row, in_force, revisions[:keep])
            shared = max(0, row.get("SharedSize") or 0)
            images.append(
                Kept(labels[LABEL_IMAGE], tags, row["Id"], row.get("Created", 0), row.get("Size", 0), shared, reasons)
            )
    return sorted(images, key=lambda image: (image.name, -image.created, image.id))


def _reasons(
    tags: Collection[str], row: Mapping[str, Any], in_force: Collection[str], revisions: Sequence[Collection[str]]
) -> tuple[str, ...]:
    said = ["in force"] * any(r in tags for r in in_force)
    used = [n for n, revision in enumerate(revisions) if any(r in tags for r in revision)]
    if used and not said:
        said = [f"{counted(used[0], 'revision')} back" if used[0] else "the last revision"]
    containers = row.get("Containers") or 0
    return (*said, counted(containers, "container")) if containers > 0 else tuple(said)
