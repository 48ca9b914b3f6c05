"""Whatever a file says: what is wrong with it is said, at its place, soon; never a traceback. FUZZ=N for N of them."""

from __future__ import annotations

import copy
import os
import random
import time

import pytest
import yaml
from mutations import mutated_text, mutated_value
from robots import write_tree

from rorg.manifest.documents import UNEXPECTED
from rorg.manifest.load import load
from rorg.store.requests_parser import parse, render

COUNT = int(os.environ.get("FUZZ", "0"))
SLOWEST = 1.0
"""Seconds for one file."""
RICH = """\
apiVersion: rorg/v1
kind: Service
metadata: {name: rich, description: everything that a service can say, labels: {team: nav}}
spec:
  image: base
  command: ["sh", "-c", "sleep 1000"]
  profile: plain
  needs: [other, {service: third, restart: true}]
  conflicts: [enemy]
  exclusive: {arm: 1}
  idle: {action: pause, linger: 20s, min_active: 1s, escalate: {after: 1m, action: stop}, reclaim: true}
  ready: {log: "^ready [0-9]+$", timeout: 30s, interval: 1s}
  live: {tcp: 8080, interval: 1s, failures: 3}
  interlock: {file: /run/estop, interval: 100ms}
  priority: 50
  resources: {cpu: 0.6, memory: 180Mi}
  may_request: [other]
  may_manage: ["nav-*"]
  mounts: ["./files:/files"]
  restart: on-failure
  container:
    environment: {A: "1", B: b}
    env_file: [some.env]
    volumes: ["./navigation:/root/navigation:ro", {type: tmpfs, target: /tmp}]
    ports: ["8080:80", "9090:90/udp"]
    devices: ["/dev/ttyUSB0:/dev/ttyUSB0:rw"]
    cap_add: [NET_ADMIN]
    ulimits: {nofile: {soft: 1024, hard: 4096}}
    shm_size: 64Mi
    stop_signal: SIGINT
    security_opt: ["no-new-privileges:true"]
    healthcheck: {test: ["CMD", "true"], interval: 5s}
"""
REQUESTS = """\
requests:
- {id: tour, requester: developer, services: [navigation], reason: visitor, ttl: 10s, priority: 3, renewed: x}
- {id: two, requester: mission, services: [a, b], incarnation: abc}
restarts: {arm: '2026-01-31T12:00:00Z'}
holds: {leg: {until: '2026-01-31T12:00:00Z', reason: x}}
suspended: {until: '2026-01-31T12:00:00Z'}
removals: [old]
"""


POLICY = """\
apiVersion: rorg/v1
kind: Policy
metadata: {name: policy}
spec:
  budget: {cpu: 4, memory: 4Gi, over: queue}
  pressure: {cpu_some: 0.5, memory_some: 0.2, admit: 50}
  resources: {arm: 1}
  resync: 30s
  bulk_workers: 2
  removals: ask
"""
PROFILE = """\
apiVersion: rorg/v1
kind: Profile
metadata: {name: own}
spec: {extends: [plain], container: {environment: {P: "1"}, volumes: ["/tmp:/host:ro"]}}
"""
IMAGE = """\
apiVersion: rorg/v1
kind: Image
metadata: {name: base}
spec: {context: ./image, args: {A: b}}
"""


def a_tree(root):
    """Everything that RICH names."""
    for name in ("other", "third", "enemy"):
        write_tree(root / name, {name: {}})
        (root / "services").mkdir(exist_ok=True)
        (root / name / "services" / f"{name}.yaml").rename(root / "services" / f"{name}.yaml")
    (root / "services" / "some.env").write_text("C=d\n")
    (root / "services" / "files").mkdir()
    (root / "services" / "navigation").mkdir()
    (root / "images" / "image").mkdir(parents=True)
    (root / "images" / "image" / "Dockerfile").write_text("FROM scratch\n")
    for folder, text in (("policies", POLICY), ("profiles", PROFILE), ("images", IMAGE)):
        (root / folder).mkdir(exist_ok=True)
        (root / folder / f"{text.split('name: ')[1].split('}')[0]}.yaml").write_text(text)
    (root / "services" / "rich.yaml").write_text(RICH)
    return root


def mutations(texts: list[str], count: int, seed: int):
    """(which of the texts, what became of it)"""
    chance = random.Random(seed)
    for _ in range(count):
        which = chance.randrange(len(texts))
        if chance.random() < 0.5:
            yield which, mutated_text(texts[which], chance)
        else:
            value = mutated_value(copy.deepcopy(yaml.safe_load(texts[which])), chance)
            yield which, yaml.safe_dump(value, allow_unicode=chance.random() < 0.5)


def test_mutated_manifests_are_read_or_refused_with_their_place(tmp_path):
    root = a_tree(tmp_path)
    assert not load(root).diagnostics
    paths = [
        root / "services" / "rich.yaml",
        *(p for f in ("policies", "profiles", "images") for p in (root / f).glob("*.yaml")),
    ]
    texts = [path.read_text() for path in paths]
    for index, (which, text) in enumerate(mutations(texts, COUNT or 400, 1)):
        paths[which].write_bytes(text.encode("utf-8", errors="surrogateescape"))
        began = time.process_time()
        try:
            found = load(root)
        except Exception as bug:
            pytest.fail(f"mutation {index}: {type(bug).__name__}: {bug}\n{text[:3000]}")
        assert time.process_time() - began < SLOWEST, text[:3000]
        assert found.catalog is not None or found.errors
        assert not [d for d in found.errors if UNEXPECTED in d.message], text[:3000]
        paths[which].write_text(texts[which])


def test_mutated_requests_files_are_read_or_refused_and_written_as_they_are_read():
    for index, (_, text) in enumerate(mutations([REQUESTS], COUNT or 400, 2)):
        began = time.process_time()
        try:
            document, diagnostics = parse(text, "requests.yaml")
            again, _ = parse(render(document), "requests.yaml") if document is not None else (None, [])
        except Exception as bug:
            pytest.fail(f"mutation {index}: {type(bug).__name__}: {bug}\n{text[:3000]}")
        assert time.process_time() - began < SLOWEST, text[:3000]
        assert diagnostics if document is None else again is not None
