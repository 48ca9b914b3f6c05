"""Mutation testing of rorg/core: each small change of it should make a test fail. `make mutants` runs this.

Arguments are names of mutants to run again, such as gates.py:54.1. MUTANTS_FILE=gates.py,idle.py takes only these
files. MUTANTS_EVERY=10 takes every tenth mutant; with MUTANTS_FROM=5 these are numbers 5, 15 and so on, counted from 0.
Mutants in equivalent.yaml are only run by name.
"""

from __future__ import annotations

import ast
import gc
import itertools
import math
import os
import re
import sys
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from common import TESTS
from mutants.operators import Mutant, mutants_of
from mutants.plant import Core
from mutants.suite import OUT, TIMED_OUT, Suite, in_child, run, texts_of

HERE = Path(__file__).parent
SURVIVORS = OUT / "survivors.txt"
SUITE = (
    "docker/test_scenarios",
    "project/test_one_planner",
    "unit/daemon/test_restarts",
    "docker/test_timesharing",
    "unit/daemon/test_shedding",
    "docker/test_pressure",
    "docker/test_pressure_cause",
    "ros/test_ros_parameters",
    "docker/test_updates",
    "unit/daemon/test_safe_updates",
    "docker/test_joined_services",
    "process/test_requests_file",
    "unit/manifest/test_objects",
    "docker/test_networks",
    "docker/test_removals",
    "docker/test_lost_requests",
    "process/test_diff",
    "unit/manifest/test_machines",
    "docker/test_secrets",
    "process/test_observe",
    "docker/test_verdicts",
    "process/test_confirmation",
    "process/test_faults",
    "docker/test_drivers",
    "unit/probes/test_several_probes",
    "process/test_shared_memory",
    "unit/manifest/test_normal_forms",
    "docker/test_guarantees",
    "unit/manifest/test_profiles",
    "process/test_fit",
    "unit/tools/sim/test_engine",
    "process/test_small_engine",
    "unit/engines/swarm/test_look",
    "process/test_graph_images",
    "process/test_notify",
    "process/test_own_programs",
    "unit/tools/compose/test_load",
)
"""Besides unit/core: tests that need no engine but the simulated one, or have some such tests."""
BUDGET = 12.0
"""Traced CPU seconds of the tests that a mutant is given."""
SLOW = 5.0
"""Traced CPU seconds above which a test is left out."""
ENOUGH = 0.95
"""Share of mutants that must be killed."""
KILLED, TIMEOUT, SURVIVED, EQUIVALENT = "killed", "timeout", "survived", "equivalent"


@dataclass
class Hunt:
    """Tries mutants one by one."""

    core: Core
    suite: Suite
    trees: dict[str, ast.Module]
    killers: dict[str, list[str]] = field(default_factory=dict)
    """Tests that killed a mutant of a function or class; they come first for its other ones."""
    tests: dict[tuple[str, int], set[str]] = field(default_factory=dict)
    """By line of core: what executes it."""
    words: dict[str, set[tuple[str, int]]] = field(default_factory=dict)
    """By word of core: where it is."""
    speak: dict[str, set[str]] = field(default_factory=dict)
    """By stem: the tests that have it in their text."""

    def __post_init__(self) -> None:
        for name, traced in self.suite.traced.items():
            for line in traced.lines:
                self.tests.setdefault(line, set()).add(name)
            for stem in _stems(texts_of(self.suite.items[name])):
                self.speak.setdefault(stem, set()).add(name)
        for file, path in self.core.paths.items():
            for number, text in enumerate(path.read_text().splitlines(), 1):
                for word in re.findall(r"\w+", text):
                    self.words.setdefault(word, set()).add((file, number))

    def outcome(self, mutant: Mutant) -> tuple[str, str]:
        """What becomes of a mutant, and by which test."""
        names = self.order(mutant)
        killer, number = in_child(lambda _: self._judge(mutant, names), 5.0)
        if killer:
            known = self.killers.setdefault(_top(mutant), [])
            known[:] = [killer, *(k for k in known if k != killer)][:8]
        return (TIMEOUT if number in TIMED_OUT else SURVIVED if killer == "" else KILLED), killer or ""

    def _judge(self, mutant: Mutant, names: Sequence[str]) -> str:
        self.core.plant(mutant, self.trees[mutant.file])
        return self.suite.first_failure(names)

    def order(self, mutant: Mutant) -> list[str]:
        """The tests that may see a mutant, in the order in which to run them: those that killed a similar mutant, then,
        for half of BUDGET each, those whose text is about the same, and files of tests in turn."""
        found = set[str]().union(*(self.tests.get(line, set()) for line in self._lines(mutant)))
        names = [k for k in self.killers.get(_top(mutant), ()) if k in found]
        about = self._about(mutant)
        for key in (lambda n: -about[n]), self._turns(found).__getitem__:
            left = BUDGET / 2
            for name in sorted(found.difference(names), key=key):
                left -= self.suite.traced[name].seconds
                names += [name] if left > 0 else []
        return names

    def _turns(self, names: Iterable[str]) -> dict[str, tuple[float, str]]:
        """When each test has its turn if all files of tests get an equal time."""
        traced, spent, turns = self.suite.traced, Counter[str](), dict[str, tuple[float, str]]()
        for name in sorted(names, key=lambda n: (traced[n].seconds, n)):
            file = name.partition("::")[0]
            spent[file] += traced[name].seconds
            turns[name] = spent[file], name
        return turns

    def _about(self, mutant: Mutant) -> Counter[str]:
        """How much the text of each test has in common with the changed expression; rare words count more."""
        scores = Counter[str]()
        for stem in _stems(mutant.change):
            speaking = self.speak.get(stem, ())
            for name in speaking:
                scores[name] += math.log(len(self.suite.traced) / len(speaking))
        return scores

    def _lines(self, mutant: Mutant) -> set[tuple[str, int]]:
        """Where a mutant is executed. For a constant or the default of a field that is wherever its name is used."""
        if mutant.inside:
            return {(mutant.file, line) for line in mutant.lines}
        if isinstance(mutant.statement, ast.FunctionDef):
            return {(mutant.file, line) for line in range(mutant.line, (mutant.statement.end_lineno or 0) + 1)}
        targets = getattr(mutant.statement, "targets", None) or [getattr(mutant.statement, "target", None)]
        used = set[tuple[str, int]]().union(*(self.words[t.id] for t in targets if isinstance(t, ast.Name)))
        return used if any(line in self.tests for line in used) else {k for k in self.tests if k[0] == mutant.file}


def _stems(text: str) -> set[str]:
    """The beginnings of the words of a text: `suspended` and `suspend` are about the same."""
    return {word[:6] for word in re.findall("[a-z]{4,}", text.lower())}


def _top(mutant: Mutant) -> str:
    return f"{mutant.file}:{mutant.top.lineno}"


def equivalents() -> dict[tuple[str, str, str], str]:
    """(file, line, change) -> why it changes nothing that anybody could see."""
    found = yaml.safe_load((HERE / "equivalent.yaml").read_text()) or {}
    return {(file, e["line"], e["change"]): e["why"] for file, entries in found.items() for e in entries}


def key_of(mutant: Mutant, core: Core) -> tuple[str, str, str]:
    """What equivalent.yaml knows a mutant by: not the number of its line, which changes with every other change."""
    return mutant.file, core.paths[mutant.file].read_text().splitlines()[mutant.line - 1].strip(), mutant.change


def chosen(mutants: Sequence[Mutant], names: Sequence[str]) -> list[Mutant]:
    """The mutants that arguments and environment ask for."""
    files = [f for f in os.environ.get("MUTANTS_FILE", "").split(",") if f]
    some = [m for m in mutants if m.name in names] if names else [m for m in mutants if not files or m.file in files]
    first, every = (int(os.environ.get(f"MUTANTS_{name}") or default) for name, default in (("FROM", 0), ("EVERY", 1)))
    return some if names else some[first::every]


def say(text: str) -> None:
    print(text, flush=True)


def tests() -> list[str]:
    """The files with tests of what core decides; the small worlds are the last resort."""
    files = [*sorted(TESTS.glob("unit/core/test_*.py")), *(TESTS / f"{name}.py" for name in SUITE)]
    return os.environ.get("MUTANTS_TESTS", "").split() or [str(f) for f in (*files, HERE / "small_worlds.py")]


def hunt(suite: Suite, names: Sequence[str]) -> bool:
    """Try the chosen mutants and say what became of them; whether enough were killed."""
    began, core = time.monotonic(), Core()
    suite.trace(SLOW, say)
    say(f"traced in {time.monotonic() - began:.0f} s")
    gc.collect()
    gc.freeze()
    trees = {file: ast.parse(path.read_text()) for file, path in core.paths.items()}
    one, known, whole = Hunt(core, suite, trees), equivalents(), Counter[str]()
    some = chosen([m for file, tree in trees.items() for m in mutants_of(file, tree)], names)
    with Path(os.devnull if names else SURVIVORS).open("w") as survivors:
        for file, mutants in itertools.groupby(some, key=lambda m: m.file):
            counts = Counter[str]()
            for mutant in mutants:
                skipped = not names and key_of(mutant, core) in known
                outcome, killer = (EQUIVALENT, "") if skipped else one.outcome(mutant)
                counts[outcome] += 1
                if names:
                    say(f"{outcome} {mutant.name} {mutant.change} {killer}")
                if outcome == SURVIVED:
                    print(f"{mutant.name}\t{mutant.change}\t{len(one.order(mutant))} tests", file=survivors, flush=True)
            say(f"{file}: {told(counts)}")
            whole += counts
    say(f"all: {told(whole)}; {time.monotonic() - began:.0f} s; survivors in {SURVIVORS}")
    return whole[SURVIVED] <= (1 - ENOUGH) * (whole.total() - whole[EQUIVALENT])


def told(count: Counter[str]) -> str:
    tried = count.total() - count[EQUIVALENT]
    dead = count[KILLED] + count[TIMEOUT]
    return (
        f"{count.total()} mutants, {count[EQUIVALENT]} equivalent, {dead} killed ({count[TIMEOUT]} by time), "
        f"{count[SURVIVED]} survived: {100 * dead / max(1, tried):.1f} %"
    )


def main(names: Sequence[str]) -> int:
    enough = list[bool]()
    code = run(tests(), lambda suite: enough.append(hunt(suite, names)))
    return code or int(not all(enough))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
