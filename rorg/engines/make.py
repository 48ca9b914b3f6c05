"""An engine by its name."""

from __future__ import annotations

from rorg.engines import ENGINES
from rorg.engines.protocol import RealEngine
from rorg.errors import Invalid
from rorg.store.engine_record import EngineRecord, check_engine
from rorg.store.state_dir import StateDir


def make_engine(name: str, state: StateDir) -> RealEngine:
    """The engine of that name, for the containers of this state directory's instance. Raises Invalid, and Refused if
    its containers are on another engine."""
    owner = state.instance()
    if name == "docker":
        from rorg.engines.docker.engine import DockerEngine

        engine = DockerEngine(owner, state=str(state.path.resolve()))
        check_engine(state, EngineRecord(name, engine.address))
        return engine
    if name == "process":
        from rorg.engines.process.engine import ProcessEngine

        check_engine(state, EngineRecord(name))
        with state.usable():
            return ProcessEngine(owner, state.path / "process")
    raise Invalid(f"use the engine '{name}'", "no such engine", " or ".join(ENGINES))
