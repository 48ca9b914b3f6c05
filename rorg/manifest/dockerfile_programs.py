"""ENTRYPOINT and CMD of a Dockerfile (Dockerfile reference, "Understand how CMD and ENTRYPOINT interact")."""

from __future__ import annotations

import json
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Program:
    """One ENTRYPOINT or CMD."""

    instruction: str
    text: str

    @property
    def by_shell(self) -> bool:
        """Whether `/bin/sh -c` runs it, because it is not a JSON list of words."""
        try:
            return not isinstance(json.loads(self.text), list)
        except (ValueError, RecursionError):
            return True


@dataclass(frozen=True, slots=True)
class Programs:
    """The programs of one stage or image, as far as its own file declares them."""

    entrypoint: Program | None = None
    command: Program | None = None
    base: str = ""
    """Reference of the image that it is based on; empty if that no longer matters."""

    def on(self, base: Programs) -> Programs:
        """Adds the entry point of its base, and the base's command unless it has an entry point itself."""
        return self if self.entrypoint else Programs(base.entrypoint, self.command or base.command, base.base)
