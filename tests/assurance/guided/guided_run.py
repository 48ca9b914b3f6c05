"""One target under a fuzzer: how inputs change, and what becomes of those that break it."""

from __future__ import annotations

import hashlib
import json
import random
import sys
import traceback
from collections.abc import Callable
from pathlib import Path

import yaml
from fuzzing import MOST_CPU, MOST_MEMORY, Figures, ended_after, measured
from guided.guided_targets import Target
from mutations import mutated_text, mutated_value
from project_mutations import mutated_lines

SLOWER = 4
"""How much slower code is whose coverage is measured."""
SELDOM = 20
HUNG = 50
"""Seconds after which an input counts as one that hangs."""


class Run:
    """Inputs that break `target` are kept in the folder `kept`, one of each kind and at most so many."""

    def __init__(self, name: str, target: Target, kept: Path, most: int) -> None:
        self.name, self.target, self.kept, self.most = name, target, kept, most
        target.every = SELDOM
        self.known: set[str] = set()
        self.figures = Figures()

    def attempt(self, data: bytes) -> None:
        """Try one input."""
        self.figures.cases += 1
        try:
            with ended_after(HUNG), measured(self.figures) as used:
                self.target.attempt(data)
            assert used.cpu < MOST_CPU * SLOWER, f"{used.cpu:.1f} s of CPU"
            assert used.memory < MOST_MEMORY, f"{used.memory:.0f} MiB"
        except Exception as bug:
            self.found(data, bug)

    def found(self, data: bytes, bug: Exception) -> None:
        frames = [f for f in traceback.extract_tb(bug.__traceback__) if "/rorg/" in f.filename]
        place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else str(bug)[:40]
        kind = f"{type(bug).__name__} at {place}"
        if kind in self.known or len(self.known) >= self.most:
            return
        self.known.add(kind)
        self.kept.mkdir(parents=True, exist_ok=True)
        path = self.kept / hashlib.sha256(data).hexdigest()[:12]
        path.write_bytes(data)
        print(f"\n{self.name}: {kind}: {str(bug)[:300]} (kept as {path})", file=sys.stderr, flush=True)

    def mutated(self, own: Callable[[bytes, int], bytes], data: bytes, most: int, seed: int) -> bytes:
        """Another input: as the fuzzer makes it (`own`), or as editors, merges and attackers make it."""
        chance = random.Random(seed)
        if chance.random() < 0.4:
            return own(data, most)
        head, sign, content = data.partition(b"\n")
        text = content.decode("utf-8", errors="surrogateescape")
        how = chance.random()
        if how < 0.4:
            text = mutated_text(text, chance)
        elif how < 0.7 and self.target.words:
            text = mutated_lines(text, self.target.words, chance)
        else:
            try:
                text = self.other_value(text, chance)
            except (yaml.YAMLError, ValueError, RecursionError, TypeError, AttributeError, OverflowError):
                text = mutated_text(text, chance)
        try:
            content = text.encode("utf-8", errors="surrogateescape")
        except UnicodeEncodeError:
            content = text.encode("utf-8", errors="replace")
        return (head + sign + content)[:most]

    def other_value(self, text: str, chance: random.Random) -> str:
        """The document with another value in it."""
        if self.target.json:
            return json.dumps(mutated_value(json.loads(text), chance))
        return str(yaml.safe_dump(mutated_value(yaml.safe_load(text), chance), allow_unicode=True))
