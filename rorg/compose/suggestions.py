"""Names that are close to unknown ones, as long as there are few of both."""

from __future__ import annotations

from collections.abc import Collection

from rorg.model.diagnostics import nearest

MOST_COMPARED = 20_000
"""Names that are compared for one project. Some hundred mistakes in a project of a hundred services need fewer."""
LONGEST = 100
"""Characters of a name that is compared."""


class Suggestions:
    """Those of one project."""

    def __init__(self) -> None:
        self._compared = 0

    def __call__(self, name: str, known: Collection[str]) -> str:
        """A remedy as nearest() gives it; empty once enough names were compared."""
        self._compared += len(known)
        if self._compared > MOST_COMPARED or len(name) > LONGEST:
            return ""
        return nearest(name, [one for one in known if len(one) <= LONGEST])
