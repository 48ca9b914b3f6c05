"""`rorg get -w`: on a terminal one table, redrawn in place; otherwise the head, and rows that change."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from rorg.cli.output import columns_of, echo, print_rows, screen_table, table, write
from rorg.cli.terminal import COLOUR

Row = Mapping[str, Any]


class Watch:
    """Shows rows again if any of them changed, not counting ages."""

    def __init__(self) -> None:
        self._seen: dict[tuple[str, str], Row] | None = None
        self._drawn = 0
        """Lines that the last table takes on the terminal."""
        self._head = ""

    def show(
        self,
        rows: Sequence[Row],
        form: str,
        columns: Sequence[str],
        wide: Sequence[str],
        *,
        full: Any = None,
        below: Sequence[str] = (),
    ) -> None:
        """As print_rows."""
        before, self._seen = self._seen, {_key(row, columns): {**row, "age": ""} for row in rows}
        if before == self._seen:
            return
        shown = columns_of(form, columns, wide)
        if form in ("table", "wide") and sys.stdout.isatty():
            self._draw(screen_table(rows, shown, below).splitlines())
            return
        before = before or {}
        changed = [row for row in rows if before.get(_key(row, columns)) != self._seen[_key(row, columns)]]
        gone = [{**dict.fromkeys(shown, "-"), columns[0]: key[0]} for key in before if key not in self._seen]
        if form in ("table", "wide"):
            self._append([*rows, *gone], [*changed, *gone], shown)
        else:
            print_rows([*changed, *gone] if form == "name" else rows, form, columns, wide, full=full)

    def _append(self, rows: list[Row], changed: list[Row], shown: Sequence[str]) -> None:
        """Prints changed rows; and the head again if columns or their widths changed."""
        head, *lines = table(rows, shown).splitlines()
        if head != self._head:
            echo(head)
        self._head = head
        for row, line in zip(rows, lines, strict=True):
            if any(row is other for other in changed):
                echo(line)

    def _draw(self, lines: list[str]) -> None:
        """Draws as many lines as fit, including the head."""
        size = os.get_terminal_size(sys.stdout.fileno())
        room, kept = (size.lines or 24) - 2, list[str]()
        for line in lines:
            room -= _height(line, size.columns or 80)
            if room < 0:
                kept.append(f"... {len(lines) - len(kept)} more lines; name services, or use --group or -l")
                break
            kept.append(line)
        write((f"\033[{self._drawn}A\r\033[J" if self._drawn else "") + "\n".join(kept))
        self._drawn = sum(_height(line, size.columns or 80) for line in kept)


def _key(row: Row, columns: Sequence[str]) -> tuple[str, str]:
    """The identity of a row: several requesters may use the same id."""
    return str(row[columns[0]]), str(row.get("requester", ""))


def _height(line: str, width: int) -> int:
    """Lines that a text takes on the terminal."""
    return max(1, -(-len(COLOUR.sub("", line)) // width))
