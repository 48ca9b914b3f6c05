"""What a Docker engine tells of itself for `rorg validate --machine`."""

from __future__ import annotations

import os
import stat

from rorg.engines.facts import engine_facts


def test_an_engine_tells_its_runtimes(dockerd):
    facts = engine_facts(dockerd.host)
    assert facts.error == ""
    assert "runc" in facts.runtimes
    assert stat.S_ISDIR(os.stat(facts.root).st_mode)
