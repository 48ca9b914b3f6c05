"""Signals by name."""

from __future__ import annotations

import signal


def signal_number(name: str) -> int:
    """The number of a signal, given its name or its number as text. Raises ValueError if the kernel does not have
    it."""
    base, sign, offset = name.partition("+") if "+" in name else name.partition("-")
    try:
        number = int(name) if name.isdecimal() else signal.Signals[base].value + int(f"{sign}{offset}" or 0)
    except (KeyError, ValueError):
        number = 0
    if not 1 <= number <= signal.SIGRTMAX:
        raise ValueError(f"no signal {name}")
    return number
