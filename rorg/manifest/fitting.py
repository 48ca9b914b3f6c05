"""`resources` of a Service's manifest by what was measured of it: its text, with only these values changed."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rorg.manifest.yaml_source import Document, read_yaml
from rorg.model.units import parse_memory

LEAST_RUN = 60.0
"""Seconds below which what was measured says little: a start is not how a service runs."""
LEAST_CPU = 0.01
"""Cores; less says nothing."""
MI = 1 << 20
AT = ("spec", "resources")
_PLAIN = re.compile(r"""'[^']*'|"[^"]*"|[^\s,}#]+""")


@dataclass(frozen=True, slots=True)
class Fit:
    """Of one service. Empty texts for what nothing is said of."""

    service: str
    seconds: float
    """For which it was measured."""
    before: Mapping[str, str]
    """cpu and memory as the manifest has them."""
    after: Mapping[str, str]
    """What is proposed; the same keys as of `text`'s changes. Empty where nothing is."""
    text: str
    """The whole manifest with it."""
    why_not: str = ""
    """Why nothing is proposed."""

    def as_json(self) -> dict[str, Any]:
        return {
            "service": self.service,
            "seconds": self.seconds,
            "before": dict(self.before),
            "after": dict(self.after),
            "why_not": self.why_not,
        }


def fit(name: str, text: str, measured: Mapping[str, Any] | None, margin: float) -> Fit:
    """What a manifest should say, and its text with that. `measured` is as the history has it (see history/usage.py).

    CPU is the mean while it runs: budgets are sums over services that do not all work at the same moment. Memory is the
    most that was seen: who lacks CPU is slow, and who lacks memory ends. Both with a margin (0.1 is a tenth) on top. A
    value that is within the margin of that stays as it is."""
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
        return "nothing is on record of what it used"
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
    """Two digits that count."""
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


def _size(value: float) -> str:
    """In Mi: two digits that count, rounded up."""
    count = math.ceil(round(value / MI, 6))
    step = 10 ** max(0, len(str(count)) - 2)
    return f"{math.ceil(count / step) * step}Mi"


def _line(values: Mapping[str, str]) -> str:
    return "resources: {" + ", ".join(f"{k}: {v}" for k, v in values.items()) + "}"


def with_resources(text: str, document: Document, values: Mapping[str, str]) -> str | None:
    """The text with these values of `resources`, and all else as it is. None where that cannot be done."""
    if any((*AT, key) in document.filled for key in values):
        return None  # a variable, which others use too
    lines = text.split("\n")
    for key, value in sorted(values.items(), reverse=True):  # what is added stands in front
        found = document.values.get((*AT, key))
        done = _replaced(lines, found, value) if found else _added(lines, document, key, value)
        again, wrong = read_yaml("\n".join(lines), document.file)
        if not done or again is None or wrong:
            return None
        document = again
    now = {k: str(v) for k, v in _declared(document).items() if k in values}
    return "\n".join(lines) if now == {k: _read(v) for k, v in values.items()} else None


def _read(text: str) -> str:
    """As the value of a text in YAML is written."""
    try:
        return str(int(text)) if text.isdigit() else str(float(text))
    except ValueError:
        return text


def _replaced(lines: list[str], place: tuple[int, int], value: str) -> bool:
    line, column = lines[place[0] - 1], place[1] - 1
    found = _PLAIN.match(line, column)
    if found is None:
        return False
    lines[place[0] - 1] = line[:column] + value + line[found.end() :]
    return True


def _added(lines: list[str], document: Document, key: str, value: str) -> bool:
    """Another key of `resources`, or `resources` as the last key of `spec`."""
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
