"""What gets images for an engine and a state directory."""

from __future__ import annotations

import time
from collections.abc import Callable

from rorg.engines.protocol import Engine
from rorg.host.clock import wall_clock
from rorg.images.order import Builder
from rorg.images.records import Records
from rorg.images.supply import Supplier
from rorg.store.state_dir import StateDir

LOGS = "builds"
"""Folder of the state directory for the logs of builds."""


def make_supplier(engine: Engine, state: StateDir, owner: str, jobs: int, imports: bool = True) -> Supplier:
    """`owner`: the instance whose images they are; `jobs`: images that are built at once. Without `imports` no command
    of an import is run: an image that stands on such a one is not built."""
    return Supplier(
        make_builder=builder_for(engine, state, imports),
        records=Records(state.path),
        logs=state.path / LOGS,
        owner=owner,
        clock=time.monotonic,
        wall=wall_clock,
        jobs=jobs,
    )


def builder_for(engine: Engine, state: StateDir, imports: bool = True) -> Callable[[], Builder]:
    """Makes builders for an engine. What they need is loaded when the first one is made."""

    def make() -> Builder:
        if engine.name == "process":
            from rorg.images.process import ProcessBuilder

            return ProcessBuilder(state.path)
        from rorg.engines.docker.engine import DockerEngine
        from rorg.images.docker import Careful, DockerBuilder

        assert isinstance(engine, DockerEngine)
        return DockerBuilder(engine) if imports else Careful(engine)

    return make
