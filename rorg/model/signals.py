"""Signals by name."""

from __future__ import annotations

import signal


def signal_number(name: str) -> int:
    """The number of a signal that read_signal() wrote."""
    base, sign, offset = name.partition("+") if "+" in name else name.partition("-")
    return int(name) if name.isdigit() else signal.Signals[base].value + int(f"{sign}{offset}" or 0)
