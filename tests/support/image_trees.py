"""Images to build, and who hears of it."""

from __future__ import annotations

import contextlib
import threading
import time
from pathlib import Path

import psutil

from rorg.engines.docker.engine import DockerEngine
from rorg.images.build import build
from rorg.images.docker import DockerBuilder
from rorg.images.order import Order, Result
from rorg.images.supply import orders_for
from rorg.manifest.dockerfile import read
from rorg.model.catalog import Catalog, Image
from rorg.model.image_names import with_identity


class Heard:
    """Everything, in the order in which it was heard: (word, name, text)."""

    def __init__(self) -> None:
        self.all: list[tuple[str, str, str]] = []
        self.stepped = threading.Event()

    def began(self, order: Order) -> None:
        self.all.append(("began", order.name, ""))

    def step(self, order: Order, text: str) -> None:
        self.all.append(("step", order.name, text))
        self.stepped.set()

    def ended(self, result: Result) -> None:
        self.all.append(("ended", result.reference, result.outcome))


def images(folder: Path, dockerfiles: dict[str, str], **fields: dict) -> Catalog:
    """An Image for each of these Dockerfiles, in a context of its own; `fields`: more of the Image, by its name."""
    found = {}
    for name, text in dockerfiles.items():
        context = folder / name
        context.mkdir(parents=True, exist_ok=True)
        (context / "Dockerfile").write_text(text)
        more = {"args": {}, **fields.get(name, {})}
        uses = read(text, more["args"], more.get("target", ""), more.get("platform", "")).uses
        bases = tuple(dict.fromkeys(use.reference for use in uses))
        image = {"dockerfile": "Dockerfile", "import_command": None, "directory": str(context), "bases": bases}
        found[name] = Image(**{"name": name, "context": str(context), **image, **more})
    return Catalog(images=found)


def orders_of(
    catalog: Catalog, there: set[str], identity: str = "0123456789abcdef", names=(), **options
) -> list[Order]:
    """With the references that an identity gives."""
    tags = {name: with_identity(name, identity) for name in catalog.images}
    identities = dict.fromkeys(catalog.images, identity)
    chosen = names or sorted(catalog.images)
    return orders_for(catalog, chosen, identities=identities, tags=tags, there=there, owner="test", **options)


class Place:
    """Where images are built for a test; all that a test built is removed at its end."""

    def __init__(self, host: str, buildkit: bool, logs: Path) -> None:
        self.engine, self.buildkit, self.logs = DockerEngine("test", host), buildkit, logs
        self.heard = Heard()
        self._built: list[Order] = []

    def builder(self) -> DockerBuilder:
        return DockerBuilder(self.engine, self.buildkit)

    def build(self, orders: list[Order], jobs: int = 2, stop: threading.Event | None = None) -> dict[str, Result]:
        """Results by the name of the image."""
        self._built += [order for order in orders if not order.there]
        found = build(
            orders, self.builder, jobs=jobs, clock=time.monotonic, listener=self.heard, stop=stop, logs=self.logs
        )
        return {order.name: result for order, result in zip(orders, found, strict=True)}

    @property
    def podman(self) -> bool:
        return self.engine.client.release.podman

    def inspect(self, reference: str) -> dict:
        return self.engine.client.get(f"/images/{reference}/json")

    def has(self, *references: str) -> set[str]:
        return self.builder().there(references)

    def running(self) -> list[str]:
        """Processes of builds, of the engine's and of ours. Podman lets a step come to its end though nobody waits for
        it: that step is ended here."""
        found = {p: " ".join(p.info["cmdline"] or ()) for p in psutil.process_iter(["cmdline"])}
        steps = [p for p, line in found.items() if "time.sleep(600)" in line]
        if self.podman:
            for step in steps:
                with contextlib.suppress(psutil.NoSuchProcess):
                    step.kill()
        return [line for p, line in found.items() if "--iidfile" in line or (p in steps and not self.podman)]

    def close(self) -> None:
        self.builder().remove([r for order in reversed(self._built) for r in (*order.also, order.reference)])
