"""Compose files with something wrong in them are read or refused, and never end in an exception of Python."""

from __future__ import annotations

import random
from pathlib import Path

from compose_cases import CASES, cases

from rorg.tools.compose import load

INSTEAD = [
    *("5", "x", "[1]", "{a: b}", "", "!reset", "~", '"${A"', "true", "[{}]", "[[]]", "{}", "{x: }", "*a", "-1", "1.5"),
    *("service:x", "[null]", "!override", '"::"', '[":"]', '"/"'),
]


def changed(lines: list[str], chance: random.Random) -> list[str]:
    """With one value, item or line that was not there, or one line less."""
    index = chance.randrange(len(lines))
    line = lines[index]
    indent = line[: len(line) - len(line.lstrip())]
    instead = chance.choice(INSTEAD)
    one = [f"{line.partition(':')[0]}: {instead}"] if ":" in line else [f"{indent}- {instead}"]
    put = chance.choice([one, one, [f"{indent}- {instead}"], [], [line, chance.choice(lines)]])
    return [*lines[:index], *put, *lines[index + 1 :]] or [""]


def test_what_is_wrong_is_told():
    chance = random.Random(0)
    outcomes = set()
    for name in cases() * 2:
        file = min((CASES / name).glob("*.y*ml"))
        lines = file.read_text().splitlines()
        for _ in range(chance.randint(1, 3)):
            lines = changed(lines, chance)

        def read(path: Path, name: str = file.name, text: str = "\n".join(lines)) -> str:
            if path == Path("/robot", name):
                return text
            raise FileNotFoundError(2, "there is only one file")

        loaded = load([Path("/robot", file.name)], {}, read)
        assert (loaded.project is None) == bool(loaded.errors), "\n".join(lines)
        assert all(d.message and d.where.line > 0 for d in loaded.diagnostics)
        outcomes.add(loaded.project is None)
    assert outcomes == {True, False}
