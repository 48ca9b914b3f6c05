"""Durations, amounts of memory and times: as people write them, and as numbers."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from decimal import Decimal

DURATION = r"^(([0-9]+(\.[0-9]+)?(ms|s|m|h|d))+|[0-9]+(\.[0-9]+)?)$"
MEMORY = r"^[0-9]+(\.[0-9]+)?([bB]|[kKmMgG]([bB]|i|iB)?)?$"
NAME = r"^[A-Za-z0-9]([A-Za-z0-9_.-]{0,61}[A-Za-z0-9_-])?$"
"""Of manifests: what Compose takes for a service, without what hides a file or names a directory (a dot in front, or at
the end) and what looks like an option (a dash in front)."""
_SECONDS = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
_BYTES = {"": 1, "b": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30}


LONGEST = 3653 * 86400.0
"""Seconds."""
LARGEST = 1 << 62
"""Bytes."""


SHORTEST_LEASE = 0.1
"""Seconds."""


def parse_duration(value: object) -> float:
    """Seconds of "20s", "1m30s" or "250ms"; a number without a unit is of seconds, as a text too."""
    if isinstance(value, str) and re.match(DURATION, value):
        parts = re.findall(r"([0-9.]+)(ms|s|m|h|d)", value) or [(value, "s")]
        found = sum(float(number) * _SECONDS[unit] for number, unit in parts)
    elif isinstance(value, int | float) and not isinstance(value, bool) and value >= 0:
        found = float(min(value, 2 * LONGEST))  # an int may be more than a float can be
    else:
        raise ValueError(f"{value!r} is not a duration; write 20s, 1m30s or 250ms, or seconds as a number")
    if found > LONGEST:
        raise ValueError(f"{value!r} is more than ten years")
    return found


def parse_lease(value: object) -> float:
    """Seconds of a lease: a duration in which whoever holds it has the time to renew it."""
    found = parse_duration(value)
    if found < SHORTEST_LEASE:
        raise ValueError(f"a lease of {value} would be over before it can be renewed; try 10s, and 100ms at the least")
    return found


def format_duration(seconds: float) -> str:
    """The same, written so that parse_duration reads it."""
    return f"{Decimal(repr(float(seconds))):f}".removesuffix(".0") + "s"


def parse_memory(value: object) -> int:
    """Bytes of "180Mi", "512m" or 1048576. Every unit is a power of 1024, as in Compose; -1 means no limit."""
    if isinstance(value, int) and not isinstance(value, bool) and -1 <= value <= LARGEST:
        return value
    if not isinstance(value, str) or not re.match(MEMORY, value):
        raise ValueError(f"{value!r} is not an amount of memory; write 180Mi, 2Gi, or bytes as a number")
    number, unit = re.match(r"([0-9.]+)(.*)", value).groups()  # type: ignore[union-attr]
    found = float(number) * _BYTES[unit[:1].lower()]
    if found > LARGEST:
        raise ValueError(f"{value!r} is more than any machine has")
    return int(found)


def format_seconds(seconds: float) -> str:
    """A duration for people: 0.4 s, 12 s, 3 m 5 s."""
    if seconds < 10:
        return f"{seconds:.1f}".rstrip("0").rstrip(".") + " s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{int(seconds) // 60} m {int(seconds) % 60} s"


def format_time(epoch: float) -> str:
    """A point in time, in seconds since the epoch, for people."""
    return datetime.fromtimestamp(epoch, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def stamp(epoch: float) -> str:
    """A point in time, in seconds since the epoch, as engines write it: ISO 8601, UTC. Two of them compare as text."""
    return datetime.fromtimestamp(epoch, UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def nano_stamp(epoch: int) -> str:
    """A point in time, in nanoseconds since the epoch, as engines stamp lines of logs. Two of them compare as text."""
    return f"{datetime.fromtimestamp(epoch // 10**9, UTC):%Y-%m-%dT%H:%M:%S}.{epoch % 10**9:09}Z"


def parse_since(text: str, now: float) -> float:
    """Seconds since the epoch of a time, or of so long before `now`: 10m, 2026-01-31T12:00:00Z. Raises ValueError."""
    try:
        return now - parse_duration(text)
    except ValueError:
        pass
    try:
        return parse_time(text)
    except ValueError as error:
        raise ValueError(f"{text!r} is not a time; write 10m, or 2026-01-31T12:00:00Z") from error


def parse_time(value: object) -> float:
    """Seconds since the epoch of an ISO 8601 time; UTC where it names no zone."""
    try:
        time = datetime.fromisoformat(str(value).replace("Z", "+00:00"))
        epoch = (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
        stamp(epoch)
        return epoch
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{value!r} is not a time; write one such as 2026-01-31T12:00:00Z") from error


def counted(number: int, noun: str) -> str:
    """A number of things for people: 1 service, 3 services."""
    return f"{number} {noun}" + "s" * (number != 1)


def format_memory(count: float) -> str:
    """Bytes for people: 180Mi, 1.2Gi."""
    for size, unit in ((1 << 30, "Gi"), (1 << 20, "Mi"), (1 << 10, "Ki")):
        if count >= size:
            return f"{count / size:.1f}{unit}" if count < 10 * size else f"{count / size:.0f}{unit}"
    return f"{count:.0f}"
