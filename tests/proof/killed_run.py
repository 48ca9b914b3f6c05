"""`rorg` that counts its effects, and kills itself at one of them. The environment says where and at which."""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from effects import Effects
from engine_link import RemoteEngine

import rorg.engines.make as make
from rorg.cli.main import run
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
        return RemoteEngine(given["PROOF_ENGINE"], state.instance(), effects)
    engine = real(name, state)
    for verb in ("create", "start", "stop", "signal", "remove", "pause", "resume", "rename", "update"):
        setattr(engine, verb, counted(verb, getattr(engine, verb)))
    return engine


def counted(verb: str, call):
    def made(*args, **more):
        with effects.effect(f"engine {verb} {str(args[0])[:12]}"):
            return call(*args, **more)

    return made


make.make_engine = make_engine
run()
