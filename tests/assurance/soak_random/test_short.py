"""The random soak for half a minute, from a fixed seed; `make soak-random` for as long as you like."""

from __future__ import annotations

import pytest
from dockerd import own_dockerd
from soak_random.run import Soak

pytestmark = pytest.mark.docker
SECONDS, SEED = 20.0, 1


def test_nothing_overlaps_and_nothing_is_lost(tmp_path):
    with own_dockerd("--live-restore") as dockerd:
        soak = Soak(tmp_path, dockerd, SEED, period=10.0)
        try:
            faults = soak.run(SECONDS)
        finally:
            soak.close()
    assert not faults, "\n".join(f"{fault.kind}: {fault.what}" for fault in faults)
    assert soak.witness.events, "it judged nothing"
    assert soak.checkpoints
