"""The robot of manifests/ with stand-ins: the same services, needs, groups and policies, with programs that do nothing
but say which edition they are. Software is an image of its own for each service, configuration a variable."""

from __future__ import annotations

import os
import shutil
import socket
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from common import BASE_IMAGE, ROOT

MANIFESTS = ROOT / "manifests"
ROS, MASTER = "tritonbot_ros", "roscore"
"""The profile of ROS programs, and the service that they follow."""
KEPT = ("always_on", "conflicts", "idle", "priority")
READY_WITHIN = "15s"
STANDIN = Path(__file__).parent / "standin.py"
PARENT = "tour_guide_base"
PORTS, ROOM = range(22100, 32000), 100
"""Ports below those that the kernel gives to connections; so many for each process that plays."""


@dataclass(frozen=True)
class Guide:
    """What manifests/ declares."""

    specs: Mapping[str, Mapping[str, Any]]

    @property
    def services(self) -> Sequence[str]:
        return sorted(self.specs)

    def needs(self, name: str) -> tuple[str, ...]:
        spec = self.specs[name]
        return (*spec.get("needs", ()), *((MASTER,) if spec["profile"] == ROS else ()))

    def follows(self, name: str) -> bool:
        """Whether it restarts together with the master."""
        return self.specs[name]["profile"] == ROS

    def wanted(self, asked: Iterable[str]) -> frozenset[str]:
        """What is always on, what is asked for, and what these need."""
        ahead = [*asked, *(name for name, spec in self.specs.items() if spec.get("always_on"))]
        found: set[str] = set()
        while ahead:
            name = ahead.pop()
            if name not in found:
                found.add(name)
                ahead += self.needs(name)
        return frozenset(found)


def tour_guide() -> Guide:
    documents = [yaml.safe_load(path.read_text()) for path in sorted((MANIFESTS / "services").glob("*.yaml"))]
    return Guide({document["metadata"]["name"]: document["spec"] for document in documents})


def free_ports(names: Sequence[str]) -> dict[str, int]:
    found: list[int] = []
    for port in PORTS[os.getpid() * ROOM % len(PORTS) :]:
        with socket.socket() as tried:
            try:
                tried.bind(("127.0.0.1", port))
            except OSError:
                continue
        found.append(port)
        if len(found) == len(names):
            break
    return dict(zip(names, found, strict=True))


def manifest(guide: Guide, name: str, port: int, edition: int, **changed: Any) -> str:
    """Of a service in one of its configurations."""
    spec = guide.specs[name]
    needs = [{"service": MASTER, "restart": True}] if guide.follows(name) else []
    told = {
        "image": name,
        "command": ["python3", "-S", "/standin.py", str(port)],
        "needs": [*needs, *spec.get("needs", ())],
        **{key: spec[key] for key in KEPT if key in spec},
        **({"driver": True} if "driver" in spec else {}),
        "ready": {"tcp": port, "timeout": READY_WITHIN},
        "container": {"environment": {"EDITION": str(edition)}},
        **changed,
    }
    return _document("Service", name, told)


def software(name: str, text: str) -> dict[str, str]:
    """Files of a service's image, by path in the tree. `text`: its /edition."""
    return {
        f"images/{name}.yaml": _document("Image", name, {"context": f"./{name}"}),
        f"images/{name}/Dockerfile": f"FROM {PARENT}\nCOPY edition /edition\n",
        f"images/{name}/edition": f"{text}\n",
    }


def begin(guide: Guide, tree: Path, ports: Mapping[str, int]) -> None:
    """Writes the whole tree, each service in its edition 0."""
    for folder in ("groups", "policies", "requests"):
        shutil.copytree(MANIFESTS / folder, tree / folder)
    files = {
        f"images/{PARENT}.yaml": _document("Image", PARENT, {"context": f"./{PARENT}"}),
        f"images/{PARENT}/Dockerfile": f"FROM {BASE_IMAGE}\nCOPY standin.py /standin.py\n",
        f"images/{PARENT}/standin.py": STANDIN.read_text(),
    }
    for name in guide.services:
        files |= software(name, "0") | {f"services/{name}.yaml": manifest(guide, name, ports[name], 0)}
    for path, text in files.items():
        (tree / path).parent.mkdir(parents=True, exist_ok=True)
        (tree / path).write_text(text)


def _document(kind: str, name: str, spec: Mapping[str, Any]) -> str:
    return yaml.safe_dump(
        {"apiVersion": "rorg/v1", "kind": kind, "metadata": {"name": name}, "spec": dict(spec)}, sort_keys=False
    )
