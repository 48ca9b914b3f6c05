"""One finding of a check, and what checks are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from rorg.manifest.validation.robot import Robot
from rorg.model.diagnostics import Where


class Finding(NamedTuple):
    """What was found where; what of it holds for all of its code stands in the table of codes."""

    code: str
    where: Where
    message: str
    remedy: str = ""
    """Empty for the one of the table."""
    severity: str = ""
    """The same."""


Check = Callable[[Robot], Iterator[Finding]]
