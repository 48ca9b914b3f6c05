"""Reads a systemd unit file, and the numbers and durations in it."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Where

LONGEST = 32 << 10
"""Characters of one setting, including its continuation lines."""
MOST_SECONDS = 86400.0
DECIMAL = r"(?:[0-9]{1,12}(?:\.[0-9]{0,12})?|\.[0-9]{1,12})"
_SPAN = re.compile(rf"({DECIMAL})\s*([a-z]*)\s*")
UNITS = {
    **dict.fromkeys(("us", "usec"), 1e-6),
    **dict.fromkeys(("ms", "msec"), 0.001),
    **dict.fromkeys(("", "s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("m", "min", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hour", "hours"), 3600.0),
}
"""Units of systemd.time(7), in seconds. Longer units are left out: no service takes days to stop."""


@dataclass
class Unit:
    """One unit file."""

    path: Path
    settings: dict[str, list[tuple[str, int]]] = field(default_factory=dict)
    """Key -> values with their lines, from all sections. An empty value discards the values before it."""

    @property
    def name(self) -> str:
        """A valid name of a manifest: camera-front for camera@front.service."""
        return re.sub(r"[^A-Za-z0-9_.-]", "-", self.path.stem).strip("._-") or "unit"

    @property
    def instance(self) -> str:
        """`front` of camera@front.service; empty for other units, and for a template."""
        return self.path.stem.partition("@")[2]

    def of_instance(self, name: str) -> Unit:
        """This template as the unit of an instance: `name` is camera@front.service."""
        return Unit(self.path.with_name(name), self.settings)

    def where(self, key: str = "") -> Where:
        """The place of the first value of a key."""
        values = self.settings.get(key)
        return Where(str(self.path), values[0][1] if values else 1)

    def all(self, key: str) -> list[str]:
        return [value for value, _ in self.settings.get(key, ())]

    def last(self, key: str, otherwise: str = "") -> str:
        return (self.all(key) or [otherwise])[-1]

    def words(self, *keys: str) -> list[str]:
        return [word for key in keys for value in self.all(key) for word in value.split()]


def read_unit(path: Path, text: str) -> Unit:
    """Parses a unit by the rules of systemd.syntax(7): a backslash continues a line, # and ; start comments."""
    unit = Unit(path)
    lines = iter(enumerate(text.splitlines(), 1))
    for number, line in lines:
        if line.lstrip()[:1] in ("", "#", ";", "["):
            continue
        parts = [line]
        while parts[-1].endswith("\\"):
            parts[-1] = parts[-1][:-1]
            parts.append(next((m for _, m in lines if m.lstrip()[:1] not in ("#", ";")), ""))
        line = " ".join(parts)
        if len(line) > LONGEST:
            raise TooMuch(Where(str(path), number), f"a line of more than {LONGEST >> 10} KiB", "shorter lines")
        key, equals, value = line.partition("=")
        if equals and value.strip():
            unit.settings.setdefault(key.strip(), []).append((value.strip(), number))
        elif equals:
            unit.settings.pop(key.strip(), None)
    return unit


def template_of(path: Path) -> Path:
    """The template of an instance: camera@.service for camera@front.service. Other paths stay as they are."""
    prefix, at, _ = path.stem.partition("@")
    return path.with_name(f"{prefix}@{path.suffix}") if at else path


def is_template(name: str) -> bool:
    """Whether it is the name of a template, such as camera@.service."""
    return name.rpartition(".")[0].endswith("@")


def with_specifiers(unit: Unit) -> tuple[Unit, dict[str, str]]:
    """The unit with its specifiers filled in as by the system's manager, and key -> the first one that has a value only
    while systemd runs."""
    prefix = unit.path.stem.partition("@")[0]
    values = {
        **{"%": "%", "n": unit.path.name, "N": unit.path.stem, "p": prefix, "P": _unescaped(prefix)},
        **{"j": prefix.rpartition("-")[2], "h": "/root", "u": "root", "U": "0", "g": "root", "G": "0", "s": "/bin/sh"},
        **{"t": "/run", "S": "/var/lib", "C": "/var/cache", "L": "/var/log", "E": "/etc", "T": "/tmp", "V": "/var/tmp"},
    }
    if unit.instance:
        values |= {"i": unit.instance, "I": _unescaped(unit.instance), "J": unit.instance.rpartition("-")[2]}
    unknown: dict[str, str] = {}

    def filled(key: str, value: str) -> str:
        def one(match: re.Match[str]) -> str:
            if match[1] not in values:
                unknown.setdefault(key, match[0])
            return values.get(match[1], match[0])

        return re.sub("%([A-Za-z%])", one, value)

    settings = {key: [(filled(key, value), line) for value, line in every] for key, every in unit.settings.items()}
    return Unit(unit.path, settings), unknown


def _unescaped(name: str) -> str:
    """A name as systemd-escape --unescape shows it."""
    return re.sub(r"\\x([0-9a-f]{2})", lambda found: chr(int(found[1], 16)), name.replace("-", "/"))


def seconds_of(text: str) -> float:
    """Seconds of a systemd time span such as "1min 5s"; 0 if it is not one, or longer than a day."""
    at, seconds = 0, 0.0
    while at < len(text):
        part = _SPAN.match(text, at)
        if not part or part[2] not in UNITS:
            return 0.0
        at, seconds = part.end(), seconds + float(part[1]) * UNITS[part[2]]
    return round(seconds, 6) if seconds <= MOST_SECONDS else 0.0


def number_of(text: str) -> int | None:
    """A whole number of at most 15 digits; None for anything else."""
    return int(text) if re.fullmatch("[0-9]{1,15}", text) else None
