"""Checks of names: of services, and ids of requests."""

from __future__ import annotations

import re
from typing import Any, Sequence

from rorg_client.errors import invalid


def check_names(what: str, services: Sequence[Any]) -> None:
    """Raises Invalid unless these are texts, at least one."""
    if not services:
        raise invalid(f"cannot {what}", "no service is named", "one at least")
    for place, name in enumerate(services, 1):
        if not isinstance(name, str):
            cause = f"argument {place} is a {type(name).__name__}, {name!r:.80}; services are named one by one"
            named = isinstance(name, (list, tuple, set, frozenset)) and all(isinstance(n, str) for n in name)
            example = ", ".join(f'"{n}"' for n in sorted(name)[:3]) if named and name else '"camera", "lidar"'
            raise invalid(f"cannot {what}", cause, f"{what}({example})")


def check_id(id: str) -> None:
    """Raises Invalid for a text that cannot be the id of a request."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}", id):
        raise invalid(
            f"cannot request as '{id}'",
            "an id begins with a letter or digit, and has at most 64 of letters, digits and _ . : -",
            "another id",
        )
