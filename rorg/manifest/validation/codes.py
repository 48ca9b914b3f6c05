"""The codes of findings: what rorg finds in manifests beside mistakes of form. The checks are in the other files of
this folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from rorg.errors import advice
from rorg.manifest.validation import table, table_of_containers


class Code(NamedTuple):
    """The common part of all findings of one code."""

    cause: str
    remedy: str
    severity: str
    """error, warning or hint. A single finding may be milder than its code."""
    once: bool
    """Whether a robot shows it only at its first place."""
    machine: bool

    @property
    def advice(self) -> str:
        """The remedy as a sentence without its full stop: "Try network_mode: host", "Drop one of them"."""
        text = advice(self.remedy).removeprefix("; ")
        return text[:1].upper() + text[1:]


_ENTRY = re.compile(r"([\w-]+)((?: \(\w+\))*): (.+?)\n  try (.+)", re.DOTALL)


def _read(text: str) -> dict[str, dict[str, Code]]:
    table: dict[str, dict[str, Code]] = {}
    for entry in re.split(r"\n(?=\S)", text.strip()):
        if entry.startswith("# "):
            family = table[entry.removeprefix("# ")] = {}
        else:
            match = _ENTRY.fullmatch(entry)
            assert match, entry
            name, marks, cause, remedy = match.groups()
            severity = next((s for s in ("error", "hint") if f"({s})" in marks), "warning")
            once, machine = "(once)" in marks, "(machine)" in marks
            family[name] = Code(re.sub(r"\n +", " ", cause), remedy, severity, once, machine)
    return table


TABLE: Mapping[str, Mapping[str, Code]] = _read(table.TEXT + table_of_containers.TEXT.lstrip())
"""By family: the sections of the reference page."""
CODES: Mapping[str, Code] = {name: code for family in TABLE.values() for name, code in family.items()}
