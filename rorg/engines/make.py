"""Makes the engine of a name: with rorg/model/engines.py, all that must know a new one."""

from __future__ import annotations

from rorg.engines.protocol import RealEngine
from rorg.errors import Invalid, RorgError
from rorg.model.engines import ENGINES, SWARM
from rorg.store.engine_record import EngineRecord, check_engine
from rorg.store.state_dir import StateDir


def make_engine(name: str, state: StateDir) -> RealEngine:
    """Make the engine of this name for the containers of the state directory's instance. Raises Invalid, and Refused
    if its containers are on another engine."""
    owner = state.instance()
    if name == "docker":
        from rorg.engines.docker.engine import DockerEngine

        engine = DockerEngine(owner, state=str(state.path.resolve()))
        check_engine(state, EngineRecord(name, engine.address))
        return engine
    if name == SWARM:
        from rorg.engines.swarm.engine import SwarmEngine
        from rorg.engines.swarm.managers import managers_named

        return SwarmEngine(owner, managers_named(), state=str(state.path.resolve()))
    if name == "process":
        from rorg.engines.process.engine import ProcessEngine

        check_engine(state, EngineRecord(name))
        with state.usable():
            return ProcessEngine(owner, state.path / "process")
    raise Invalid(f"use the engine '{name}'", "no such engine", " or ".join(ENGINES))


def available_engine(owner: str) -> tuple[str, str]:
    """(name, why) of the best engine that works here without any set-up: Docker if it answers, otherwise processes."""
    from rorg.engines.docker.engine import DockerEngine

    try:
        return DockerEngine.name, f"{DockerEngine(owner).ping()} answers"
    except RorgError as error:
        return "process", f"Docker does not answer: {error.why}"
