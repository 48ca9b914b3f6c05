"""The robot of a walk: one in virtual time with mounted files and a real journal, from which the next rorg begins."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace

from bounded.virtual import WorldRobot
from bounded.walk_worlds import BAD, DEAF, Edits, WalkWorld

from rorg.core.desired import Desired
from rorg.core.masking import Masker
from rorg.core.observed import Container
from rorg.core.operations import Signal, Start
from rorg.core.plan import Action
from rorg.daemon.history import Historian
from rorg.history.database import Database
from rorg.history.evidence import Earlier, earlier_revisions
from rorg.history.revisions import Revision
from rorg.host.git import Commit
from rorg.model.units import stamp
from rorg.tools.sim.engine import iso

ENDS_AFTER = 0.5
"""Seconds after which a program with a bad file ends."""


class Journal:
    """A real journal: what each commit declares, what the history says of it, and what outlives rorg."""

    def __init__(self, robot: WalkRobot, folder: Path) -> None:
        self.robot, self.folder = robot, folder
        self.states: list[Edits] = []
        self.tree = SimpleNamespace()
        """What the loop has read since the last commit."""
        self.noted: Edits | None = None
        """What the history was told of last."""
        self.begin()

    def begin(self) -> None:
        wall = lambda: stamp(self.robot.wall)  # noqa: E731
        self.database = Database(self.folder / "journal.db", wall)
        self.historian = Historian(self.database, wall, Masker(), lambda *_: None)

    def take_over(self) -> None:
        """A new rorg begins with what the journal has."""
        self.database.close()
        self.begin()
        self.robot.reborn(self.historian.remembered(self.robot.now, self.robot.boot))

    def note(self) -> None:
        """After a pass, as the loop does."""
        robot, self.noted = self.robot, self.states[-1]
        self.historian.note(robot.decision, robot.decision.memory, self.tree, robot.boot)

    def commit(self, edits: Edits, desired: Desired) -> None:
        """Note what a new commit declares."""
        commit = Commit(f"{len(self.states):040x}", "Ann", "", "", False)
        self.states.append(edits)
        self.tree = SimpleNamespace(
            desired=desired, commit=commit, errors=(), loaded=True, overtaken=False, robot="", here=""
        )

    def revisions(self) -> Iterator[tuple[Revision, Edits]]:
        """Return each revision with what it declares, the newest first."""
        for revision in self.historian.revisions.list(1000):
            yield revision, self.states[int(revision.commit, 16)]

    def earlier(self) -> list[Earlier]:
        return earlier_revisions(self.database)


class WalkRobot(WorldRobot):
    """`held` says until when, by the loop's clock, a person holds a service."""

    def __init__(self, world: WalkWorld, folder: Path) -> None:
        edits = world.trees.first()
        desired = world.trees.load(edits)
        assert desired is not None
        super().__init__(desired.catalog)
        self.deaf.add(f"tcp {DEAF}")
        self.boot = "this boot"
        self.world, self.held = world, dict[str, float]()
        self.downtimes = 0
        """How often something ended containers while rorg or the engine did not run. More than once is a pattern."""
        self.disturbed = False
        """Whether anything happened that may end a good program."""
        self.standings: dict[int, str] = {}
        """Revision -> what the history said of it at the last rest."""
        self.journal = Journal(self, folder)
        self.commit(edits)
        stranger = Container("f" * 64, "stranger", "", "running", started_at=iso(-10.0), created_at=iso(-10.0))
        self.engine.containers[stranger.id] = stranger
        self.engine.strangers = frozenset((stranger.id,))

    @property
    def edits(self) -> Edits:
        return self.journal.states[-1]

    def commit(self, edits: Edits) -> bool:
        """A person writes manifests and files. A tree that rorg refuses changes nothing."""
        desired = self.world.trees.load(edits)
        if desired is None or (self.journal.states and edits == self.edits):
            return False
        self.journal.commit(edits, desired)
        self.desired, self.faults.bad = desired, self.world.trees.bad
        self.bad_probes = frozenset(n for i, n in enumerate(self.world.names) if edits.bad_probe(i))
        self.bad_files = frozenset(n for n, f in zip(self.world.names, edits.files, strict=True) if f in BAD)
        return True

    def _done(self, action: Action) -> None:
        """A program that reads a bad file at its start, or when it is told to, ends soon."""
        super()._done(action)
        if isinstance(action.operation, (Start, Signal)) and action.service in self.bad_files:
            container = self.engine.containers[action.container]
            self.at(self.now + ENDS_AFTER, partial(self._crash, container.id, container.incarnation))
