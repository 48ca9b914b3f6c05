"""Undo over random histories: good and bad changes of manifests and mounted files, requests, releases, reverts,
rollbacks, `down` and `up`, and kills of rorg, in virtual time with a real journal.

A program with a bad version ends whenever it runs; one with a good version never does. So every word of the history can
be compared with what has happened.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rorg.core.desired import desire
from rorg.core.masking import Masker
from rorg.core.memory import STALLED_AFTER
from rorg.daemon.history import Historian
from rorg.history.database import Database
from rorg.history.evidence import earlier_revisions
from rorg.host.git import Commit
from rorg.model.catalog import DEVELOPER, Catalog, Request, Service, Updating
from rorg.model.units import stamp
from rorg.store.requests_document import RequestsDocument
from rorg.tools.sim.robot import SimRobot

NAMES = ("arm", "nav")
VERSIONS = range(4)
BAD = (1, 3)
"""Versions of a manifest, or of a mounted file, whose programs end."""
CALM = 130.0
"""Seconds in which everything is known: longer than all back-offs, bakes and stable runs together."""
WELL = 5.0
"""Seconds of a run that prove it, with some to spare."""
State = dict[str, tuple[int, int]]
"""Service -> versions of its manifest and of the file that it mounts."""


def is_bad(versions: tuple[int, int]) -> bool:
    return any(version in BAD for version in versions)


def desired_of(state: State):
    services = {
        name: Service(name, spec={"image": f"img:{manifest}"}, update=Updating(bake=2.0))
        for name, (manifest, _) in state.items()
    }
    catalog = Catalog({DEVELOPER: Service(DEVELOPER, meta=True, always_on=True), **services}, fingerprint=repr(state))
    return desire(catalog, contents={name: {f"services/{name}": str(file)} for name, (_, file) in state.items()})


@dataclass
class World:
    """A robot in virtual time, and its journal. `states`: what each commit declares."""

    folder: Path
    states: list[State] = field(default_factory=lambda: [dict.fromkeys(NAMES, (0, 0))])
    ran_well: set[tuple[str, tuple[int, int]]] = field(default_factory=set)
    ends: dict[tuple[str, tuple[int, int]], set[str]] = field(default_factory=dict)
    """The runs of a version that ended on their own."""
    standings: dict[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.sim = SimRobot(desired_of(self.state).catalog)
        self.began: dict[str, float] = {}
        self.take_over()
        self.declare()

    @property
    def state(self) -> State:
        return self.states[-1]

    def take_over(self) -> None:
        """A new rorg begins with what the journal has."""
        wall = lambda: stamp(self.sim.wall)  # noqa: E731
        self.database = Database(self.folder / "journal.db", wall)
        self.historian = Historian(self.database, wall, Masker(), lambda *_: None)
        self.sim.reborn(self.historian.remembered(self.sim.now, self.sim.boot))

    def declare(self) -> None:
        self.desired = self.sim.desired = desired_of(self.state)
        digests = self.desired.digests
        self.sim.faults.bad = {digests[n]: "exit" for n, (manifest, _) in self.state.items() if manifest in BAD}
        self.sim.faults.crash_after = {n: 0.5 for n, (_, file) in self.state.items() if file in BAD}

    def commit(self, state: State) -> None:
        self.states.append(state)
        self.declare()

    def run(self, seconds: float) -> None:
        end = self.sim.now + seconds
        self.sim.at(end, lambda: None)
        self.sim.run(lambda _: self.note() or self.sim.now >= end, seconds + 1.0)

    def note(self) -> None:
        """After a pass: the history, and what has really happened."""
        number = len(self.states) - 1
        commit = Commit(f"{number:040x}", "Ann", "", "", False)
        tree = SimpleNamespace(
            desired=self.desired, commit=commit, errors=(), loaded=True, overtaken=False, robot="", here=""
        )
        decision = self.sim.decision
        self.historian.note(decision, decision.memory, tree, self.sim.boot)
        for name in NAMES:
            current, versions = decision.situation.observed.current(name), self.state[name]
            read = decision.memory.of(name).update.content.get(f"services/{name}") == str(versions[1])
            ours = current is not None and read and current.digest == self.desired.digests[name]
            if ours and current.ended and current.exit_code == 1:
                self.ends.setdefault((name, versions), set()).add(current.incarnation)
            key = f"{name} {versions} {current.incarnation if current else ''}"
            runs = ours and current.state == "running" and name in decision.situation.wanted
            self.began = {k: at for k, at in self.began.items() if k.split()[0] != name or (runs and k == key)}
            if runs and self.sim.now - self.began.setdefault(key, self.sim.now) >= WELL:
                self.ran_well.add((name, versions))

    def revisions(self) -> Iterator:
        for revision in self.historian.revisions.list(1000):
            yield revision, self.states[int(revision.commit, 16)]

    def check(self) -> None:
        """Compare what the history says with what has happened."""
        listed = list(self.revisions())
        for revision, _ in listed:
            before = self.standings.get(revision.number)
            assert before != "failed" or revision.standing == "failed", f"{revision.number} failed, and no more"
            self.standings[revision.number] = revision.standing
        now, state = listed[0]
        first = listed[-1][1]
        ended = [n for n, v in state.items() if (n, v) in self.ends]
        stalled = [n for n, v in state.items() if len(self.ends.get((n, v), ())) >= STALLED_AFTER]
        if now.standing == "good":
            unproven = [n for n, v in state.items() if (n, v) not in self.ran_well and v != first[n]]
            unproven = [n for n in unproven if not self.was_good_before(listed, n, state[n])]
            assert not ended, f"called good, though {ended} ended"
            assert not unproven, f"called good, though {unproven} never ran well"
        if now.standing == "failed":
            assert ended, "called failed, though nothing ended"
        assert now.standing == "failed" or not stalled, f"called {now.standing}, though {stalled} ended again and again"
        self.check_rollback(state, {r.number: s for r, s in listed})

    @staticmethod
    def was_good_before(listed, name: str, versions: tuple[int, int]) -> bool:
        """Whether an earlier revision was good with it: then it was no change."""
        return any(r.standing == "good" and s[name] == versions for r, s in listed[1:])

    def check_rollback(self, state: State, states: dict[int, State]) -> None:
        updates = {name: self.sim.decision.memory.of(name).update for name in NAMES}
        failing = {n for n, u in updates.items() if u.edition in u.failures and n in {m for m, _ in self.ran_well}}
        for one in earlier_revisions(self.database):
            then = states[one.number]
            changed = [(n, v) for n, v in then.items() if v != state[n]]
            if not one.doubt:
                assert all(key in self.ran_well for key in changed), f"trusts {one.number}: {changed}"
                assert not any(is_bad(v) for _, v in changed)
                assert failing <= {n for n, _ in changed}, f"trusts {one.number}, which leaves {failing} as they are"
            elif one.unchanged:
                assert not {n for n, _ in changed} & {*one.unchanged}
            elif changed:
                assert not all(key in self.ran_well for key in changed), f"doubts {one.number}: {one.doubt}"

    def rollback(self) -> None:
        """To the first revision that can be trusted, by a commit."""
        states = {r.number: s for r, s in self.revisions()}
        goal = next((one.number for one in earlier_revisions(self.database) if not one.doubt), None)
        if goal is not None:
            assert states[goal] != self.state
            self.commit(states[goal])

    def down_and_up(self) -> None:
        """Everything is removed; the journal stays."""
        self.sim.document = RequestsDocument()
        self.sim.engine.containers.clear()
        self.database.close()
        self.take_over()


EDITS = st.tuples(st.just("edit"), st.sampled_from(NAMES), st.integers(0, 1), st.sampled_from(VERSIONS))
ASKS = st.tuples(st.sampled_from(["request", "release"]), st.sampled_from(NAMES))
OTHERS = st.tuples(st.sampled_from(["revert", "rollback", "down", "kill", "rest", "rest"]))
STEPS = st.lists(st.tuples(EDITS | ASKS | OTHERS, st.sampled_from([0.3, 3.0, CALM])), min_size=2, max_size=14)


def take(world: World, verb: str, *of) -> None:
    if verb == "edit":
        name, part, version = of
        versions = tuple(version if index == part else old for index, old in enumerate(world.state[name]))
        if versions != world.state[name]:
            world.commit({**world.state, name: versions})
    elif verb == "request":
        asked = Request(of[0], DEVELOPER, of)
        world.sim.document = world.sim.document.put(asked)
    elif verb == "release":
        world.sim.document = world.sim.document.without({(DEVELOPER, of[0])})
    elif verb == "revert" and len(world.states) > 1:
        world.commit(world.states[-2])
    elif verb == "rollback":
        world.rollback()
    elif verb == "down":
        world.down_and_up()
    elif verb == "kill":
        world.database.close()
        world.take_over()


@pytest.mark.slow
@given(STEPS)
@settings(max_examples=int(os.environ.get("RORG_TEST_EXAMPLES") or 60), suppress_health_check=[HealthCheck.too_slow])
def test_what_history_says_is_so_and_a_rollback_leads_to_what_was_proven(steps):
    with tempfile.TemporaryDirectory() as folder:
        world = World(Path(folder))
        world.run(1.0)
        for step, seconds in steps:
            take(world, *step)
            world.run(seconds)
            world.run(CALM)
            world.check()
        world.database.close()
