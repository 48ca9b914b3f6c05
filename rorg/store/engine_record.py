"""Records which engine the containers of a state directory are on. From another engine rorg would not see them: they
would run on, and nothing would manage them."""

from __future__ import annotations

import json
import os
from typing import NamedTuple

from rorg.errors import Refused
from rorg.store.files import write_atomic
from rorg.store.state_dir import StateDir, read_json

NAME = "engine"
UNIX = "unix://"


class EngineRecord(NamedTuple):
    """An engine. `address` has the form of DOCKER_HOST, or of several with commas (the managers of a Swarm); it is
    empty for an engine that is built in, or if no record says where the engine is."""

    name: str
    address: str = ""

    def __str__(self) -> str:
        return f"{self.name} ({self.address})" if self.address else self.name

    def same(self, other: EngineRecord) -> bool:
        """Whether both may be one engine."""
        mine, theirs = ({_real(a) for a in one.address.split(",") if a} for one in (self, other))
        return self.name == other.name and (not mine or not theirs or not mine.isdisjoint(theirs))


def read_engine(state: StateDir) -> EngineRecord | None:
    """The engine on which this robot has containers; None if there are none. If an older rorg kept no record, what it
    published last tells."""
    record = read_json(state.path / NAME)
    if record and isinstance(record.get("name"), str) and isinstance(record.get("address"), str):
        return EngineRecord(record["name"], record["address"])
    last = read_json(state.status) or {}
    name, services = last.get("engine_name"), last.get("services")
    if not (isinstance(name, str) and isinstance(services, dict)):
        return None
    there = any(isinstance(s, dict) and s.get("state") not in ("none", "meta") for s in services.values())
    return EngineRecord(name) if there else None


def record_engine(state: StateDir, engine: EngineRecord) -> None:
    """Record, durably, where the containers of this robot are. Raises OSError."""
    if read_json(state.path / NAME) != engine._asdict():
        write_atomic(state.path / NAME, json.dumps(engine._asdict()) + "\n")


def check_engine(state: StateDir, engine: EngineRecord) -> None:
    """Raises Refused if this robot has containers on another engine."""
    known = read_engine(state)
    if known is None or known.same(engine):
        return
    there = f"DOCKER_HOST={known.address} " if known.address else ""
    raise Refused(
        f"use {engine} for {state.path}",
        f"its containers are on {known}, and would run on there unmanaged",
        f"`{there}rorg down --engine {known.name}` first, or another --state-dir; "
        f"if that engine no longer exists, remove {state.path / NAME}",
    )


def _real(address: str) -> str:
    """The same text for all paths of a socket."""
    return UNIX + os.path.realpath(address.removeprefix(UNIX)) if address.startswith(UNIX) else address
