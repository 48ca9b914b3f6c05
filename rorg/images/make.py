"""What gets images for an engine and a state directory."""

from __future__ import annotations

import time

from rorg.engines.protocol import Engine
from rorg.host.clock import wall_clock
from rorg.images.order import Builder
from rorg.images.process import ProcessBuilder
from rorg.images.records import Records
from rorg.images.supply import Supplier
from rorg.store.state_dir import StateDir

LOGS = "builds"
"""Folder of the state directory for the logs of builds."""


def make_supplier(engine: Engine, state: StateDir, owner: str, jobs: int, imports: bool = True) -> Supplier:
    """`owner`: the instance whose images they are; `jobs`: images that are built at once. Without `imports` no command
    of an import is run, so what stands on such an image is not built unless that is there."""
    return Supplier(
        make_builder=lambda: make_builder(engine, state, imports),
        records=Records(state.path),
        logs=state.path / LOGS,
        owner=owner,
        clock=time.monotonic,
        wall=wall_clock,
        jobs=jobs,
    )


def make_builder(engine: Engine, state: StateDir, imports: bool = True) -> Builder:
    """One that has images where this engine runs them. What it needs is loaded with the first one. Raises
    Unreachable."""
    from rorg.engines.docker.engine import DockerEngine

    if not isinstance(engine, DockerEngine):
        return ProcessBuilder(state.path)
    from rorg.images.docker import DockerBuilder

    return DockerBuilder(engine, imports=imports)
