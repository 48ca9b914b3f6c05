"""The trial of a new container: which one is tried, and which one is kept to go back to. A new container carries the id
of the previous one in a label, so after a crash of rorg the next run knows which is which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rorg.core.observed import Container
from rorg.core.update import Update


def candidate(containers: Sequence[Container], update: Update) -> tuple[Container, Container] | None:
    """Return (new container, previous one) while the new one is not proven."""
    known = {c.id: c for c in containers}
    proven = _proven(known, update)
    return next(((c, known[c.previous]) for c in containers if c.previous in known and c.id not in proven), None)


def _proven(known: Mapping[str, Container], update: Update) -> set[str]:
    """Return the containers that are over their trial: the one that was proven last, and those that came before it.
    They may still be there because others are joined to them."""
    proven, last = set[str](), update.proven
    while last and last not in proven:
        proven.add(last)
        last = known[last].previous if last in known else ""
    return proven


def went_back(new: Container, old: Container) -> bool:
    """Return whether the previous container runs again after the new one was tried. rorg stops the previous one before
    it starts the new one, so it was rorg that went back."""
    return old.alive and not new.alive and bool(new.started_at or new.error)


def is_outlived(container: Container, containers: Sequence[Container], update: Update) -> bool:
    """Return whether a container that never ran would go back past one that was proven since it was made. It is made
    anew, with that one as its way back."""
    if container.started_at or not container.previous or container.id == update.proven:
        return False
    proven = next((c for c in containers if c.id == update.proven and not c.lost), None)
    return proven is not None and proven.previous == container.previous
