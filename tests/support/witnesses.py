"""What rorg said in a test that failed: everything that runs an rorg is known here until it is closed."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

LINES = 60
"""So many of the last ones are shown."""


class Witness(Protocol):
    closed: bool

    def told(self) -> str: ...


KNOWN: list[Witness] = []


def told() -> list[tuple[str, str]]:
    """A heading and a text of each."""
    return [(f"rorg {number}", _told(witness)) for number, witness in enumerate(KNOWN, 1)]


def forget_closed() -> None:
    KNOWN[:] = [witness for witness in KNOWN if not witness.closed]


def last_lines(path: Path) -> str:
    lines = path.read_text(errors="replace").splitlines() if path.exists() else []
    return "\n".join(lines[-LINES:])


def _told(witness: Witness) -> str:
    try:
        return witness.told()
    except Exception as error:  # the test's own failure is what counts
        return f"cannot be told: {type(error).__name__}: {error}"
