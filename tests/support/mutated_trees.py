"""Trees and requests files that are mutated, and what must hold of the result."""

from __future__ import annotations

from dataclasses import replace

from robots import write_tree

from rorg.model.catalog import Catalog, Request
from rorg.model.diagnostics import Where
from rorg.store.requests_document import RequestsDocument
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


def is_planned(catalog: Catalog) -> None:
    robot = SimRobot(catalog)
    robot.document = RequestsDocument((Request("all", "developer", ("rich",)),))
    for _ in range(3):
        robot.step()
    assert not robot.decision.violations, robot.decision.violations


def placeless(document: RequestsDocument) -> RequestsDocument:
    return replace(document, requests=tuple(replace(r, where=Where("")) for r in document.requests))
