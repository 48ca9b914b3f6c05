"""`rorg` that counts its effects, and kills itself at one of them. The environment says where and at which."""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))


from proof.effects import Effects
from proof.engine_images import RemoteBuilder, RemoteImages
from proof.engine_link import RemoteEngine

import rorg.daemon.wiring as wiring
import rorg.engines.make as make
from rorg.cli.main import run
from rorg.daemon.running import Running
from rorg.host.load import Meter
from rorg.images.supply import Supplier
from rorg.store.state_dir import StateDir

given = os.environ
effects = Effects(
    tuple(given["PROOF_ROOTS"].split(os.pathsep)),
    int(given["PROOF_POINT"]),
    given["PROOF_SIDE"],
    given["PROOF_TRACE"],
)
effects.install()
real = make.make_engine


def make_engine(name: str, state: StateDir) -> object:
    """The sim engine of the harness; a real one with `PROOF_DOCKER`."""
    if "PROOF_ENGINE" in given:
        kind = RemoteImages if "PROOF_IMAGES" in given else RemoteEngine
        remote = kind(given["PROOF_ENGINE"], state.instance(), effects)
        if "PROOF_LOAD" in given:
            give_load(remote)
        return remote
    engine = real(name, state)
    for verb in ("create", "start", "stop", "signal", "remove", "pause", "resume", "rename", "update"):
        setattr(engine, verb, counted(verb, getattr(engine, verb)))
    return engine


def give_load(engine: RemoteEngine) -> None:
    """The machine's load is that of the harness, although its engine is not one of this machine."""
    wiring.Meter = lambda clock: Meter(clock, lambda: engine._call("load"))
    Running.sample_every = lambda self: limits.step if (limits := self.limits()) else None


def counted(verb: str, call):
    def made(*args, **more):
        with effects.effect(f"engine {verb} {str(args[0])[:12]}"):
            return call(*args, **more)

    return made


make.make_engine = make_engine
if "PROOF_IMAGES" in given:
    Supplier.make_builder = lambda self: RemoteBuilder(self.engine)
run()
