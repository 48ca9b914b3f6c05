"""Building images: parents before children, the engine's cache kept; a failure stops what stands on it."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import IO, Protocol

from rorg.errors import EngineError, Invalid, RorgError
from rorg.host.commands import end
from rorg.manifest.files import read_text
from rorg.model.catalog import Catalog, Image
from rorg.store.files import write_atomic
from rorg.store.state_dir import read_json

SAID = 500
"""Bytes of the last words of an import command that failed."""
PATIENCE = 10.0
"""Seconds for which an import command may go on once its stream has been read."""


class Builder(Protocol):
    """Where images come to be."""

    def has(self, reference: str) -> bool: ...
    def pull(self, reference: str) -> None: ...
    def build(self, image: Image, say: Callable[[str], None]) -> None: ...
    def load(self, image: Image) -> None: ...


@dataclass(frozen=True)
class Result:
    """What became of one image."""

    image: str
    outcome: str
    """built, imported, present, pulled, failed or skipped."""
    message: str = ""


def parents(dockerfile: str, args: Mapping[str, str]) -> list[str]:
    """References that a Dockerfile stands on: its FROM lines (and COPY --from), with build arguments filled in; names
    of its own stages left out."""
    values: dict[str, str] = {}
    stages: set[str] = set()
    found: list[str] = []
    for line in re.sub(r"\\\n", " ", dockerfile).splitlines():
        words = line.split()
        if len(words) < 2 or words[0].startswith("#"):
            continue
        if words[0].upper() == "ARG" and not found:
            name, _, default = words[1].partition("=")
            values[name] = args.get(name, default.strip("\"'"))
        elif words[0].upper() == "FROM":
            rest = [w for w in words[1:] if not w.startswith("--")]
            found.append(re.sub(r"\$\{?(\w+)(:-[^}]*)?\}?", lambda m: values.get(m[1], (m[2] or "")[2:]), rest[0]))
            if len(rest) == 3 and rest[1].upper() == "AS":
                stages.add(rest[2])
        elif words[0].upper() == "COPY":
            found += [w[7:] for w in words if w.startswith("--from=") and not w[7:].isdigit()]
    return [p for p in dict.fromkeys(found) if p not in stages and p != "scratch"]


def image_parents(image: Image) -> list[str]:
    """Of one image of the tree. Raises Invalid when its Dockerfile cannot be read."""
    if image.context is None:
        return []
    try:
        text = read_text(Path(image.context) / image.dockerfile, Path(image.context))
    except OSError as error:
        raise Invalid(
            f"build {image.name}", f"{image.where}: {image.dockerfile}: {error.strerror}", "to create the Dockerfile"
        ) from error
    return parents(text, image.args)


def order(catalog: Catalog, names: Iterable[str]) -> list[tuple[str, list[str]]]:
    """The named images and all below them, parents first, each with its parents. References that are no image of the
    tree are included: they are pulled when missing."""
    graph: dict[str, list[str]] = {}
    pending = list(names)
    while pending:
        name = pending.pop()
        if name not in graph:
            graph[name] = image_parents(catalog.images[name]) if name in catalog.images else []
            pending += graph[name]
    try:
        return [(name, graph[name]) for name in TopologicalSorter(graph).static_order()]
    except CycleError as error:
        cycle = " -> ".join(error.args[1])
        raise Invalid("build", f"images stand on each other: {cycle}", "to break the cycle") from error


def build(catalog: Catalog, names: Iterable[str], builder: Builder, say: Callable[[str], None]) -> list[Result]:
    """Builds in order; what stands on a failed image is skipped. `say` gets one line for each step."""
    results: dict[str, Result] = {}
    for name, below in order(catalog, names):
        broken = [p for p in below if results[p].outcome in ("failed", "skipped")]
        if broken:
            results[name] = Result(name, "skipped", f"stands on {broken[0]}")
        else:
            results[name] = _one(catalog, name, builder, say)
        tail = f": {results[name].message}" if results[name].message else ""
        say(f"{results[name].outcome:<8} {name}{tail}")
    return list(results.values())


def _one(catalog: Catalog, name: str, builder: Builder, say: Callable[[str], None]) -> Result:
    image = catalog.images.get(name)
    try:
        if image is None:
            if builder.has(name):
                return Result(name, "present")
            builder.pull(name)
            return Result(name, "pulled")
        if image.import_command:
            if builder.has(name):
                return Result(name, "present")
            builder.load(image)
            return Result(name, "imported")
        builder.build(image, say)
        return Result(name, "built")
    except RorgError as error:
        return Result(name, "failed", error.why)


@contextlib.contextmanager
def import_stream(image: Image) -> Iterator[IO[bytes]]:
    """Runs an image's import command as long as the block; its standard output is the tar stream. Raises EngineError
    with what it said last when it fails."""
    try:
        process = subprocess.Popen(
            image.import_command or (),
            cwd=image.directory,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
    except OSError as error:
        raise EngineError(f"import {image.name}", str(error), "to look at spec.import") from error
    assert process.stdout
    assert process.stderr
    said = bytearray()
    listener = threading.Thread(target=_listen, args=(process.stderr, said), daemon=True)
    listener.start()
    try:
        yield process.stdout
        process.stdout.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE)
    finally:
        end(process, signal.SIGTERM)
        listener.join(PATIENCE)
    if process.returncode != 0:
        why = said.decode(errors="replace").strip()
        raise EngineError(f"import {image.name}", why or f"exit code {process.returncode}", "to look at spec.import")


def _listen(pipe: IO[bytes], said: bytearray) -> None:
    """Keeps the end of what a command says, and never makes it wait."""
    with pipe:
        while chunk := os.read(pipe.fileno(), 1 << 16):
            said[:] = (said + chunk)[-SAID:]


class ProcessBuilder:
    """On the process engine an image stands for the programs in its context and in its parents' contexts: their
    folders come first in PATH. Noted in the state directory."""

    def __init__(self, catalog: Catalog, state: Path) -> None:
        self.catalog, self.path = catalog, state / "process-images.json"
        self.images: dict[str, list[str]] = read_json(self.path) or {}

    def has(self, reference: str) -> bool:
        return reference in self.images

    def pull(self, reference: str) -> None:
        self._note(reference, [])

    def load(self, image: Image) -> None:
        self._note(image.name, [])

    def build(self, image: Image, say: Callable[[str], None]) -> None:
        below = [folder for parent in image_parents(image) for folder in self.images.get(parent, [])]
        self._note(image.name, [str(image.context), *below])

    def _note(self, name: str, folders: list[str]) -> None:
        self.images[name] = folders
        write_atomic(self.path, json.dumps(self.images), durable=False)
