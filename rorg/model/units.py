"""Durations, amounts of memory and times: conversion between text and numbers."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from decimal import Decimal
from math import ceil

DURATION = r"^(([0-9]+(\.[0-9]+)?(ms|s|m|h|d))+|[0-9]+(\.[0-9]+)?)$"
MEMORY = r"^[0-9]+(\.[0-9]+)?([bB]|[kKmMgG]([bB]|i|iB)?)?$"
NAME = r"^[A-Za-z0-9]([A-Za-z0-9_.-]{0,61}[A-Za-z0-9_-])?$"
"""Names of manifests: names that Compose accepts for a service, except those that hide a file or name a directory (a
dot at the start or end) or look like an option (a dash at the start)."""
_SECONDS = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
_BYTES = {"": 1, "b": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30}


LONGEST = 3653 * 86400.0
"""Seconds."""
LARGEST = 1 << 62
"""Bytes."""


SHORTEST_LEASE = 0.1
"""Seconds."""


def parse_duration(value: object) -> float:
    """Converts "20s", "1m30s" or "250ms" to seconds; a number without a unit, even as text, is seconds."""
    if isinstance(value, str) and re.match(DURATION, value):
        parts = re.findall(r"([0-9.]+)(ms|s|m|h|d)", value) or [(value, "s")]
        seconds = sum(float(number) * _SECONDS[unit] for number, unit in parts)
    elif isinstance(value, int | float) and not isinstance(value, bool) and value >= 0:
        seconds = float(min(value, 2 * LONGEST))  # an int may be too large for a float
    else:
        raise ValueError(f"{value!r} is not a duration; write 20s, 1m30s or 250ms, or seconds as a number")
    if seconds > LONGEST:
        raise ValueError(f"{value!r} is more than ten years")
    return seconds


def parse_lease(value: object) -> float:
    """Seconds of a lease, which must be long enough to be renewed."""
    seconds = parse_duration(value)
    if seconds < SHORTEST_LEASE:
        raise ValueError(f"a lease of {value} would be over before it can be renewed; try 10s, and 100ms at the least")
    return seconds


def format_duration(seconds: float) -> str:
    """The inverse of parse_duration."""
    return f"{Decimal(repr(float(seconds))):f}".removesuffix(".0") + "s"


def parse_memory(value: object) -> int:
    """Converts "180Mi", "512m" or 1048576 to bytes. Every unit is a power of 1024, as in Compose; -1 means no limit."""
    if isinstance(value, int) and not isinstance(value, bool) and -1 <= value <= LARGEST:
        return value
    if not isinstance(value, str) or not re.match(MEMORY, value):
        raise ValueError(f"{value!r} is not an amount of memory; write 180Mi, 2Gi, or bytes as a number")
    number, unit = re.match(r"([0-9.]+)(.*)", value).groups()  # type: ignore[union-attr]
    amount = float(number) * _BYTES[unit[:1].lower()]
    if amount > LARGEST:
        raise ValueError(f"{value!r} is more than any machine has")
    return int(amount)


def format_seconds(seconds: float) -> str:
    """Formats a duration for people: 0.4 s, 12 s, 3 m 5 s."""
    if seconds < 10:
        return f"{seconds:.1f}".rstrip("0").rstrip(".") + " s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{int(seconds) // 60} m {int(seconds) % 60} s"


def format_left(seconds: float) -> str:
    """Formats the time left until something for people: in 8 s; now, if none is left."""
    return f"in {format_seconds(max(1.0, float(ceil(seconds - 1e-6))))}" if seconds > 0 else "now"


def format_time(epoch: float) -> str:
    """Formats a time, in seconds since the epoch, for people."""
    return datetime.fromtimestamp(epoch, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def stamp(epoch: float) -> str:
    """Formats a time, in seconds since the epoch, like engines do: ISO 8601, UTC. Such texts sort by time."""
    return datetime.fromtimestamp(epoch, UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def nano_stamp(epoch: int) -> str:
    """Formats a time, in nanoseconds since the epoch, like engines stamp lines of logs. Such texts sort by time."""
    return f"{datetime.fromtimestamp(epoch // 10**9, UTC):%Y-%m-%dT%H:%M:%S}.{epoch % 10**9:09}Z"


def parse_since(text: str, now: float) -> float:
    """Converts a time, or a duration before `now`, to seconds since the epoch: 10m, 2026-01-31T12:00:00Z. Raises
    ValueError."""
    try:
        return now - parse_duration(text)
    except ValueError:
        pass
    try:
        return parse_time(text)
    except ValueError as error:
        raise ValueError(f"{text!r} is not a time; write 10m, or 2026-01-31T12:00:00Z") from error


def parse_time(value: object) -> float:
    """Converts an ISO 8601 time to seconds since the epoch; UTC if it names no zone."""
    try:
        time = datetime.fromisoformat(str(value).replace("Z", "+00:00"))
        epoch = (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
        stamp(epoch)
        return epoch
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{value!r} is not a time; write one such as 2026-01-31T12:00:00Z") from error


def counted(number: int, noun: str) -> str:
    """Formats a number of things: 1 service, 3 services."""
    return f"{number} {noun}" + "s" * (number != 1)


def format_memory(count: float) -> str:
    """Formats bytes for people: 180Mi, 1.2Gi."""
    for size, unit in ((1 << 30, "Gi"), (1 << 20, "Mi"), (1 << 10, "Ki")):
        if count >= size:
            return f"{count / size:.1f}{unit}" if count < 10 * size else f"{count / size:.0f}{unit}"
    return f"{count:.0f}"
