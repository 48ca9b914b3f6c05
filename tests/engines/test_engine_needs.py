"""Each cell of docs/reference/engines.md, tried: what rorg needs of an engine, on the one that RORG_TEST_ENGINE
names and on plain processes. `make engines` records what it finds; otherwise a cell must be as recorded."""

from __future__ import annotations

import json
import os

import pytest
from common import ROOT
from engine_needs import LIFE, Bench, Need
from engine_objects import OBJECTS

from rorg.engines.docker.engine import DockerEngine
from rorg.engines.docker.lacking import capabilities
from rorg.engines.facts import engine_facts
from rorg.model.engines import capabilities_of
from rorg.model.options import OPTIONS

RECORD = ROOT / "docs/reference/engines.json"
NEEDS = (*LIFE, *OBJECTS)


@pytest.fixture
def docker_bench(dockerd, tmp_path):
    engine = DockerEngine(f"needs{os.getpid()}", dockerd.host)
    engine.capabilities = capabilities(engine.client)
    found = Bench(engine, tmp_path, dict(engine_facts(dockerd.host).lacking))
    yield found
    found.close()


@pytest.fixture
def process_bench(process_engine, tmp_path):
    ignored = capabilities_of("process").ignored(frozenset(OPTIONS))
    found = Bench(process_engine, tmp_path, dict.fromkeys(ignored, "ignored"))
    yield found
    found.close()


def row(need: Need) -> str:
    return (need.__doc__ or "").splitlines()[0]


def check(bench: Bench, need: Need, column: str) -> None:
    cell = need(bench) or "yes"
    record = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    if os.environ.get("RORG_TEST_RECORD"):
        record.setdefault(row(need), {})[column] = cell
        ordered = {row(n): record[row(n)] for n in NEEDS if row(n) in record}
        RECORD.write_text(json.dumps(ordered, indent=2) + "\n")
    else:
        assert record[row(need)][column] == cell


@pytest.mark.docker
@pytest.mark.parametrize("need", NEEDS, ids=lambda need: need.__name__)
def test_an_engine_does_what_the_table_says(docker_bench, dockerd, need):
    check(docker_bench, need, dockerd.title)


@pytest.mark.parametrize("need", NEEDS, ids=lambda need: need.__name__)
def test_plain_processes_do_what_the_table_says(process_bench, need):
    check(process_bench, need, "processes")
