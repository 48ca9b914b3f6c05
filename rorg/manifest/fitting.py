"""Proposes `resources` for a Service from measurements, and writes them into the manifest's text without other
changes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from rorg.manifest.yaml_source import Document, read_yaml
from rorg.model.units import parse_memory

LEAST_RUN = 60.0
"""Seconds. A shorter measurement says little, because a start is not typical."""
LEAST_CPU = 0.01
"""Cores. Less is not meaningful."""
MI = 1 << 20
AT = ("spec", "resources")
_PLAIN = re.compile(r"""'[^']*'|"[^"]*"|[^\s,}#]+""")


@dataclass(frozen=True, slots=True)
class Fit:
    """The proposal for one service."""

    service: str
    seconds: float
    """Length of the measurement."""
    before: Mapping[str, str]
    """cpu and memory in the manifest."""
    after: Mapping[str, str]
    """The proposed values that differ from the manifest; empty if there are none."""
    text: str
    """The whole manifest with the proposed values."""
    why_not: str = ""
    """Why there is no proposal."""

    def as_json(self) -> dict[str, Any]:
        return {name: value for name, value in asdict(self).items() if name != "text"}


def fit(name: str, text: str, measured: Mapping[str, Any] | None, margin: float) -> Fit:
    """Proposes values for a manifest. `measured` is in the form of the history (see history/usage.py).

    CPU is the mean while the service runs: budgets are sums over services that do not all work at the same time. Memory
    is the peak: too little CPU slows a service down, too little memory kills it. Both get a margin on top (0.1 is a
    tenth). A declared value within the margin of that stays.
    """
    document, _ = read_yaml(text, name)
    declared = _declared(document)
    before, seconds = {k: str(v) for k, v in declared.items()}, float(measured["seconds"]) if measured else 0.0
    why_not = _too_little(measured)
    if why_not or measured is None or document is None:
        return Fit(name, seconds, before, {}, text, why_not or "its manifest cannot be read")
    cpu, memory = max(LEAST_CPU, measured["cpu"] * (1 + margin)), max(MI, measured["peak_memory"] * (1 + margin))
    wanted = {}
    if not _near(_number(declared.get("cpu")), cpu, margin):
        wanted["cpu"] = _cores(cpu)
    if not _near(_bytes(declared.get("memory")), memory, margin):
        wanted["memory"] = _size(memory)
    if not wanted:
        return Fit(name, seconds, before, {}, text, "it is as declared")
    changed = with_resources(text, document, wanted)
    if changed is None:
        return Fit(name, seconds, before, {}, text, f"its manifest has no place for {_line(wanted)}: write it there")
    return Fit(name, seconds, before, wanted, changed)


def _too_little(measured: Mapping[str, Any] | None) -> str:
    if measured is None:
        return "no measurements of it are on record"
    return f"it was measured for only {measured['seconds']:.0f} s" if measured["seconds"] < LEAST_RUN else ""


def _declared(document: Document | None) -> Mapping[str, Any]:
    value: Any = document.value if document else None
    for key in AT:
        value = value.get(key) if isinstance(value, dict) else None
    return {k: v for k, v in value.items() if k in ("cpu", "memory")} if isinstance(value, dict) else {}


def _near(declared: float | None, wanted: float, margin: float) -> bool:
    return declared is not None and abs(declared - wanted) <= max(margin, 0.01) * wanted


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _bytes(value: Any) -> float | None:
    try:
        return float(parse_memory(value))
    except ValueError:
        return None


def _cores(value: float) -> str:
    """Rounded to two significant digits."""
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


def _size(value: float) -> str:
    """In Mi, rounded up to two significant digits."""
    count = math.ceil(round(value / MI, 6))
    step = 10 ** max(0, len(str(count)) - 2)
    return f"{math.ceil(count / step) * step}Mi"


def _line(values: Mapping[str, str]) -> str:
    return "resources: {" + ", ".join(f"{k}: {v}" for k, v in values.items()) + "}"


def with_resources(text: str, document: Document, values: Mapping[str, str]) -> str | None:
    """Returns the text with these values of `resources` and no other changes; None if that is impossible."""
    if any((*AT, key) in document.filled for key in values):
        return None  # the value is a variable, which other fields may use too
    lines = text.split("\n")
    for key, value in sorted(values.items(), reverse=True):  # new keys are inserted at the front
        place = document.values.get((*AT, key))
        done = _replaced(lines, place, value) if place else _added(lines, document, key, value)
        again, wrong = read_yaml("\n".join(lines), document.file)
        if not done or again is None or wrong:
            return None
        document = again
    now = {k: str(v) for k, v in _declared(document).items() if k in values}
    return "\n".join(lines) if now == {k: _read(v) for k, v in values.items()} else None


def _read(text: str) -> str:
    """Normalizes a number as YAML reads it."""
    try:
        return str(int(text)) if text.isdigit() else str(float(text))
    except ValueError:
        return text


def _replaced(lines: list[str], place: tuple[int, int], value: str) -> bool:
    line, column = lines[place[0] - 1], place[1] - 1
    match = _PLAIN.match(line, column)
    if match is None:
        return False
    lines[place[0] - 1] = line[:column] + value + line[match.end() :]
    return True


def _added(lines: list[str], document: Document, key: str, value: str) -> bool:
    """Adds a key to `resources`, or adds `resources` as the last key of `spec`."""
    at = document.values.get(AT)
    if at is not None:
        return _added_to(lines, document, at, key, value)
    first = min((place for path, place in document.keys.items() if path[:-1] == ("spec",)), default=None)
    if first is None or document.keys[("spec",)][0] == first[0]:
        return False
    after = [p[0] for path, p in document.keys.items() if len(path) == 1 and p[0] > first[0]]
    end = min(after, default=len(lines) + 1) - 1
    while end > first[0] and (not lines[end - 1].strip() or lines[end - 1].startswith("#")):
        end -= 1
    lines.insert(end, " " * (first[1] - 1) + _line({key: value}))
    return True


def _added_to(lines: list[str], document: Document, at: tuple[int, int], key: str, value: str) -> bool:
    line, column = lines[at[0] - 1], at[1] - 1
    if line[column : column + 1] == "{":
        rest = line[column + 1 :]
        comma = "" if rest.lstrip().startswith("}") else ", "
        lines[at[0] - 1] = f"{line[: column + 1]}{key}: {value}{comma}{rest}"
        return True
    first = min((place for path, place in document.keys.items() if path[:-1] == AT), default=None)
    if first is None:
        return False
    lines.insert(first[0] - 1, " " * (first[1] - 1) + f"{key}: {value}")
    return True
