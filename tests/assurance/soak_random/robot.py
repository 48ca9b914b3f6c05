"""The robot of the random soak: its manifests, their editions, and the `rorg run` that keeps it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import witnesses
import yaml
from common import SUPPORT, wait_for
from robots import write_tree
from rorg_client import Client
from soak_random.judge import Rules, Span

LABEL = "soak.edition"
PROGRAM = """
import pathlib, signal, sys
for number in (2, 15):
    signal.signal(number, lambda *_: sys.exit(0))
told = pathlib.Path("/conf/conf")
if told.exists() and "bad" in told.read_text():
    sys.exit(3)
pathlib.Path("/tmp/ready").touch()
print("serving", flush=True)
while True:
    signal.pause()
"""
STEPPED = SUPPORT / "programs/stepped.py"
PAUSED = {"idle": {"action": "pause", "linger": 0, "escalate": {"after": "2s", "action": "stop"}}}
KEPT_PAUSED = {"idle": {"action": "pause", "linger": 0}}
LINGERS = {"idle": {"action": "stop", "linger": "1s"}}
LOG, FILE = {"ready": {"log": "serving", "timeout": "10s"}}, {"ready": {"file": "/tmp/ready", "timeout": "10s"}}
SERVICES: Mapping[str, dict] = {
    "clock": {"always_on": True, **LOG},
    "diagnostics": {"always_on": True, "needs": ["clock"]},
    "camera": {**PAUSED, **LOG},
    "lidar": {**KEPT_PAUSED, **LOG, "driver": True},
    "imu": {**LINGERS, **FILE},
    "map": {**PAUSED, "mounts": ["./map:/conf"]},
    "localization": {"needs": ["camera", "lidar"], **LINGERS, **LOG},
    "navigation": {"needs": ["localization", "map", "clock"], "conflicts": ["mapping"], **PAUSED},
    "mapping": {"needs": ["lidar"], "conflicts": ["docking"], **PAUSED, **LOG},
    "docking": {"conflicts": ["navigation"], **KEPT_PAUSED},
    "detector": {"exclusive": ["gpu"], "needs": ["camera"], **PAUSED, "priority": 60},
    "segmenter": {"exclusive": ["gpu"], **KEPT_PAUSED},
    "tracker": {"exclusive": ["gpu"], "priority": 80, **LINGERS, **LOG},
    "speech": {"exclusive": ["gpu"], "mounts": ["./speech:/conf"]},
    "arm": {"exclusive": ["bus"], "driver": True, **LOG},
    "gripper": {"exclusive": ["bus"], "driver": True, "needs": [{"service": "arm", "restart": True}]},
    "head": {"exclusive": ["bus"], **PAUSED},
    "light": {"exclusive": {"bus": 2}, "priority": 55, **KEPT_PAUSED},
    "fan": {"exclusive": ["bus"], "priority": 40, "idle": {"action": "remove"}},
    "teleop": {"conflicts": ["auto"], **PAUSED, **FILE},
    "auto": {**PAUSED, "needs": ["imu"]},
    "display": {"conflicts": ["teleop"], "mounts": ["./display:/conf"]},
    "logger": {"mounts": ["./logger:/conf"], **FILE},
    "charger": {"update": {"bake": "4s"}},
    "dock": {"needs": ["charger"], "update": {"bake": "1s"}, **PAUSED},
    "left": {"update": {"atomic": "wheels"}, **LINGERS},
    "right": {"update": {"atomic": "wheels"}, **LINGERS, **LOG},
}
GROUPS = {"perception": {"services": ["camera", "imu", "detector"]}, "wheels": {"services": ["left", "right"]}}
POLICY = {"robot": {"resources": {"bus": 2}, "updates": {"bake": "500ms"}, "resync": "20s"}}
MOUNTING = tuple(name for name, spec in SERVICES.items() if "mounts" in spec)
DRIVERS = frozenset(name for name, spec in SERVICES.items() if "driver" in spec)
SETS = (frozenset(("left", "right")),)
GOOD, CRASHES, SILENT, REFUSED = "good", "crashes", "silent", "refused"
"""How an edition is. One that is refused has a field that no manifest has."""
Editions = Mapping[str, tuple[int, int]]
"""Service -> the numbers of its manifest and of the file that it mounts."""


def needs(name: str) -> list[str]:
    return [n if isinstance(n, str) else n["service"] for n in SERVICES[name].get("needs", ())]


def with_needs(names: Iterable[str]) -> set[str]:
    """Services, of groups and services, with all that they need."""
    found, ahead = set[str](), [*names]
    while ahead:
        name = ahead.pop()
        if name in GROUPS:
            ahead += GROUPS[name]["services"]
        elif name not in found:
            found.add(name)
            ahead += needs(name)
    return found


def rules() -> Rules:
    pairs = {frozenset((name, other)) for name, spec in SERVICES.items() for other in spec.get("conflicts", ())}
    exclusive = {name: spec["exclusive"] for name, spec in SERVICES.items() if "exclusive" in spec}
    users = {n: dict.fromkeys(used, 1) if isinstance(used, list) else used for n, used in exclusive.items()}
    return Rules(frozenset(pairs), users, POLICY["robot"]["resources"])


def spec_of(name: str, number: int, kind: str) -> dict:
    """The manifest of a service in one of its editions."""
    command = ["python3", "-S", "-c", PROGRAM]
    more = dict(SERVICES[name])
    if kind == CRASHES:
        command = ["python3", "-S", "-c", "raise SystemExit(3)"]
    elif kind == SILENT:
        more["ready"] = {"file": "/tmp/never", "timeout": "2s"}
    elif kind == REFUSED:
        more["imgae"] = "x"
    container = {"labels": {LABEL: str(number)}, "stop_grace_period": "2s"}
    return {"command": command, "container": container, **more}


@dataclass
class Tree:
    """The manifests on the disk, in a repository."""

    root: Path
    kinds: dict[int, str] = field(default_factory=lambda: {0: GOOD})
    """How each edition is, by its number."""
    written: dict[str, float] = field(default_factory=dict)
    """Service -> when the file that it mounts was written last."""

    def begin(self) -> None:
        write_tree(self.root, {n: spec_of(n, 0, GOOD) for n in SERVICES}, groups=GROUPS, policies=POLICY)
        for name in MOUNTING:
            self.conf(name).parent.mkdir(parents=True)
            self.conf(name).write_text("0")
        self.git("init", "--quiet")
        self.commit("Begin")

    def conf(self, name: str) -> Path:
        """The file that a service mounts."""
        return self.root / "services" / name / "conf"

    def git(self, *words: str) -> str:
        person = ("-c", "user.name=Ann", "-c", "user.email=ann@lab")
        return subprocess.check_output(["git", "-C", self.root, *person, *words], text=True, stderr=subprocess.DEVNULL)

    def commit(self, message: str) -> None:
        self.git("add", "--all")
        self.git("commit", "--quiet", "--allow-empty", "--message", message)

    def clean(self) -> bool:
        return not self.git("status", "--porcelain").strip()

    def save(self, name: str, number: int, kind: str) -> None:
        """Write one manifest in place, as an editor does."""
        self.kinds[number] = kind
        path = self.root / "services" / f"{name}.yaml"
        document = yaml.safe_load(path.read_text())
        document["spec"] = {"image": document["spec"]["image"], **spec_of(name, number, kind)}
        path.write_text(yaml.safe_dump(document, sort_keys=False))

    def save_file(self, name: str, number: int, kind: str) -> None:
        self.kinds[number] = kind
        self.conf(name).write_text(f"{number} bad" if kind == CRASHES else f"{number}")

    def editions(self) -> Editions:
        """What is on the disk."""
        found = {}
        for name in SERVICES:
            text = (self.root / "services" / f"{name}.yaml").read_text()
            number = int(re.search(rf"{LABEL}: '?(\d+)", text)[1])
            file = int(self.conf(name).read_text().split()[0]) if name in MOUNTING else 0
            found[name] = number, file
        return found

    def bad(self, editions: Editions) -> frozenset[str]:
        """Services that cannot work in these editions."""
        return frozenset(name for name, numbers in editions.items() if any(self.kinds[n] != GOOD for n in numbers))


class Rorg:
    """A `rorg run` on Docker, on a clock of its own: killed, frozen, started again."""

    def __init__(self, folder: Path, tree: Path, host: str) -> None:
        self.folder, self.tree, self.host, self.state = folder, tree, host, folder / "state"
        self.process: subprocess.Popen | None = None
        self.offset, self.log = folder / "clock", folder / "rorg.log"
        self.offset.write_text("0")
        self.away: list[Span] = []
        """When neither it nor its engine could act."""
        self.lock = threading.Lock()
        self.closed = False
        witnesses.KNOWN.append(self)

    def told(self) -> str:
        return witnesses.last_lines(self.log)

    def start(self) -> None:
        """In the main thread: it ends with the thread that started it."""
        words = ["run", str(self.tree), "--state-dir", str(self.state), "--engine", "docker"]
        tied = ["setpriv", "--pdeathsig", "KILL"] if shutil.which("setpriv") else []
        command = [*tied, sys.executable, str(STEPPED), str(self.offset), *words]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log, env=self.environment())
        wait_for((self.state / "run/rorg.sock").exists, 60, "rorg to serve")

    def environment(self) -> dict[str, str]:
        return {**os.environ, "DOCKER_HOST": self.host, "RORG_STATE_DIR": str(self.state), "RORG_ENGINE": "docker"}

    def stop(self, kill: bool) -> None:
        (self.process.kill if kill else self.process.terminate)()
        self.process.wait(60)

    def client(self, **more: float) -> Client:
        return Client(str(self.state / "run/rorg.sock"), **more)

    def close(self) -> None:
        self.closed = True
        if self.process and self.process.poll() is None:
            self.process.kill()
            self.process.wait(60)
