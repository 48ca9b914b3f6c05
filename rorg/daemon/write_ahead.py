"""What rorg writes down before it acts, so that it recognizes its own containers after a crash."""

from __future__ import annotations

from rorg.core.decide import Decision
from rorg.daemon.recorder import Recorder
from rorg.engines.protocol import Engine
from rorg.model.former import Kept
from rorg.store.engine_record import EngineRecord, record_engine
from rorg.store.last_good import read_kept, write_kept
from rorg.store.state_dir import StateDir


class WriteAhead:
    """Writes what is declared and what was, before another tree is acted on; and the engine, before anything is made
    there."""

    def __init__(self, state: StateDir, engine: Engine, recorder: Recorder) -> None:
        self.state, self.engine, self.recorder = state, engine, recorder
        self._bound = False
        """Whether the state directory has the engine of its containers."""

    def read(self) -> Kept:
        """Return what an earlier rorg wrote down."""
        return read_kept(self.state.path)

    def write(self, before: Kept, decision: Decision) -> None:
        """Write what a decision needs. If the disk refuses, rorg reports it, and the robot goes on."""
        kept = decision.memory.kept
        try:
            if not self._bound and (decision.begin or decision.situation.observed.containers):
                record_engine(self.state, EngineRecord(self.engine.name, self.engine.address))
                self._bound = True
            if kept.catalog is not before.catalog or kept.former != before.former:
                write_kept(self.state.path, kept)
        except OSError as error:
            self.recorder.when_new("last-good", str(error), "last-good-not-written", str(error))
