"""Signals by name."""

from __future__ import annotations

import signal


def signal_number(name: str) -> int:
    """Of a signal by its name, or by its number as text. Raises ValueError for one that the kernel does not have."""
    base, sign, offset = name.partition("+") if "+" in name else name.partition("-")
    try:
        number = int(name) if name.isdecimal() else signal.Signals[base].value + int(f"{sign}{offset}" or 0)
    except (KeyError, ValueError):
        number = 0
    if not 1 <= number <= signal.SIGRTMAX:
        raise ValueError(f"no signal {name}")
    return number
