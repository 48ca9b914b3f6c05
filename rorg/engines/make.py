"""An engine by its name."""

from __future__ import annotations

import uuid

from rorg.engines import ENGINES
from rorg.engines.protocol import RealEngine
from rorg.errors import Invalid
from rorg.store.state_dir import StateDir


def make_engine(name: str, state: StateDir) -> RealEngine:
    """The engine of that name, for the containers of this state directory's instance. Raises Invalid."""
    owner = state.instance(lambda: uuid.uuid4().hex)
    if name == "docker":
        from rorg.engines.docker.engine import DockerEngine

        return DockerEngine(owner)
    if name == "process":
        from rorg.engines.process.engine import ProcessEngine

        with state.usable():
            return ProcessEngine(owner, state.path / "process")
    raise Invalid(f"use the engine '{name}'", "no such engine", " or ".join(ENGINES))
