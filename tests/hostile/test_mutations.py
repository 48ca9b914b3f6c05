"""Whatever a file says: what is wrong with it is said, at its place, soon; never a traceback."""

from __future__ import annotations

import copy
import random
from dataclasses import replace

import pytest
import yaml
from fuzzing import Case, fuzz
from mutations import mutated_text, mutated_value
from robots import write_tree

from rorg.core.desired import desire
from rorg.host.contents import Contents
from rorg.manifest.documents import UNEXPECTED
from rorg.manifest.load import load
from rorg.model.catalog import Catalog, Request
from rorg.model.diagnostics import Where
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_parser import parse, render
from rorg.tools.sim.robot import SimRobot

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
    network_mode: bridge
    working_dir: /tmp
    user: "1000:1000"
    mem_limit: 512Mi
    memswap_limit: 1Gi
    cpus: 1.5
    cpuset: "0-1"
    pids_limit: 100
    oom_score_adj: 10
    sysctls: {net.core.somaxconn: "1024"}
    tmpfs: ["/run:size=64m"]
    logging: {driver: json-file, options: {max-size: 10m}}
    extra_hosts: ["robot:10.0.0.1"]
    dns: [10.0.0.1]
    group_add: [dialout]
    blkio_config: {weight: 300}
    stop_grace_period: 5s
    labels: {a: b}
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
spec: {context: ./image, args: {A: b}, target: run, platform: linux/arm64}
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
    (root / "images" / "image" / "Dockerfile").write_text("ARG A\nFROM ${A} AS run\nFROM scratch\n")
    for folder, text in (("policies", POLICY), ("profiles", PROFILE), ("images", IMAGE)):
        (root / folder).mkdir(exist_ok=True)
        (root / folder / f"{text.split('name: ')[1].split('}')[0]}.yaml").write_text(text)
    (root / "services" / "rich.yaml").write_text(RICH)
    return root


def mutation(texts: list[str], chance: random.Random) -> tuple[int, str]:
    """(which of the texts, what becomes of it)"""
    which = chance.randrange(len(texts))
    if chance.random() < 0.4:
        return which, mutated_text(texts[which], chance)
    value = copy.deepcopy(yaml.safe_load(texts[which]))
    for _ in range(chance.choice((1, 1, 1, 3))):
        value = mutated_value(value, chance)
    return which, yaml.safe_dump(value, allow_unicode=chance.random() < 0.5)


def is_planned(catalog: Catalog) -> None:
    robot = SimRobot(catalog)
    robot.document = RequestsDocument((Request("all", "developer", ("rich",)),))
    for _ in range(3):
        robot.step()
    assert not robot.decision.violations, robot.decision.violations


@pytest.mark.fuzz
def test_mutated_manifests_are_read_or_refused_with_their_place(tmp_path):
    root = a_tree(tmp_path)
    assert not load(root).errors
    folders = [root / folder for folder in ("policies", "profiles", "images")]
    paths = [root / "services" / "rich.yaml", *(path for folder in folders for path in folder.glob("*.yaml"))]
    texts = [path.read_text() for path in paths]

    def attempt(case: Case) -> None:
        which, case.text = mutation(texts, case.chance)
        paths[which].write_bytes(case.text.encode("utf-8", errors="surrogateescape"))
        try:
            found = load(root)
            if found.catalog is not None:
                desire(found.catalog, str(root), Contents().of(found.catalog, root))
                if not case.number % 5:
                    is_planned(found.catalog)
        finally:
            paths[which].write_text(texts[which])
        assert found.catalog is not None or found.errors
        unexpected = [str(d) for d in found.errors if UNEXPECTED in d.message]
        assert not unexpected, unexpected

    fuzz("manifests", 300, attempt)


def placeless(document: RequestsDocument) -> RequestsDocument:
    return replace(document, requests=tuple(replace(r, where=Where("")) for r in document.requests))


@pytest.mark.fuzz
def test_mutated_requests_files_are_read_or_refused_and_written_as_they_are_read():
    def attempt(case: Case) -> None:
        _, case.text = mutation([REQUESTS], case.chance)
        document, diagnostics = parse(case.text, "requests.yaml")
        assert document is not None or diagnostics
        assert document is None or placeless(parse(render(document), "requests.yaml")[0]) == placeless(document)

    fuzz("requests", 300, attempt)
