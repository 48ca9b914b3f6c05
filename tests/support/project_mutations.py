"""Mutations of the files of a project: lines that go, come, move, multiply, and words that such files are made of."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence

from mutations import mutated_text

TIMES = (1, 1, 1, 2, 10, 300, 3000)


def mutated_project(files: Mapping[str, str], words: Sequence[str], chance: random.Random) -> tuple[str, str]:
    """(which file, what becomes of it). `words`: lines and pieces of lines that its format knows."""
    name = chance.choice(sorted(files))
    text = files[name]
    for _ in range(chance.choice((1, 1, 2, 4))):
        text = mutated_text(text, chance) if chance.random() < 0.35 else mutated_lines(text, words, chance)
    return name, text


def mutated_lines(text: str, words: Sequence[str], chance: random.Random) -> str:
    """The text with one line changed."""
    lines = text.split("\n")
    at = chance.randrange(len(lines))
    line = lines[at]
    indent = line[: len(line) - len(line.lstrip())]
    word = chance.choice(words)
    column = chance.randint(0, len(line))
    key, sign, _ = line.partition(chance.choice((": ", "=")))
    lines[at : at + 1] = chance.choice(
        (
            [],
            [line] * chance.choice(TIMES),
            [line, f"{indent}{word}"],
            [f"{indent}{word}"] * chance.choice(TIMES),
            [f"{key}{sign}{word}"],
            [f"{line[:column]}{word}{line[column:]}"],
            [f"{line[:column]}{word * chance.choice(TIMES)}{line[column:]}"],
            [chance.choice(lines), line],
        )
    )
    return "\n".join(lines)
