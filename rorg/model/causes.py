"""Groups services that wait for the same reason, so that people read one root cause once."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

SHOWN = 3
"""Services that are named of a larger group."""
_OWN = (
    (re.compile(r"\bcannot (\w+) [^\s:]+:"), r"cannot \1 them:"),
    (re.compile(r"^(\w+) stalled: "), r"\1 failed: "),
    (re.compile(r"; (again in [\d. sm]+|trying again now)(?=$|;)"), ""),
    (re.compile(r"\b[0-9a-f]{12,64}\b"), "..."),
)
"""What differs between services that fail for one reason: the container, its id, the number of attempts, and the time
of the next one."""


class Cause(NamedTuple):
    """A reason, and the services that have it."""

    names: tuple[str, ...]
    why: str

    @property
    def who(self) -> str:
        """A name, or how many services and some of their names."""
        first, more = ", ".join(self.names[:SHOWN]), len(self.names) - SHOWN
        if len(self.names) == 1:
            return first
        return f"{len(self.names)} services ({first}{f' and {more} more' if more > 0 else ''})"

    def __str__(self) -> str:
        return f"{self.who}: {self.why}"


def causes(reasons: Iterable[tuple[str, str]]) -> list[Cause]:
    """Group (service, reason) by reason, in the order of the first of each. Reasons are equal if they differ only in
    what is the container's own."""
    by_cause: dict[str, list[tuple[str, str]]] = {}
    for name, why in reasons:
        by_cause.setdefault(common_cause(why), []).append((name, why))
    return [_cause(common, members) for common, members in by_cause.items()]


def _cause(common: str, members: list[tuple[str, str]]) -> Cause:
    whys = {why for _, why in members}
    return Cause(tuple(dict.fromkeys(name for name, _ in members)), common if len(whys) > 1 else members[0][1])


def verb_before(reason: str) -> str:
    """Return the verb to put between a service and why it waits; "" if the reason has one: `waits for gpu`."""
    return "" if reason.startswith(("waits ", "lingers ")) else "waits: "


def common_cause(why: str) -> str:
    """Return a reason without what is the container's own."""
    for pattern, put in _OWN:
        why = pattern.sub(put, why)
    return why
