"""What all parts of an import from Compose share: the project, where things go, and what is told."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rorg.compose.project import Project
from rorg.importing.compose_keys import Row
from rorg.importing.manifests import NOTE
from rorg.model.diagnostics import Diagnostic
from rorg.model.units import format_duration

UNITS = (("Gi", 1 << 30), ("Mi", 1 << 20), ("Ki", 1 << 10))
SOUND = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9_.-]{0,61}[A-Za-z0-9_-])?")
"""What a manifest may be called."""
Step = str | int


@dataclass
class Work:
    """One import under way."""

    project: Project
    tree: Path
    """Where the manifests go; absolute."""
    top: Path
    """Paths below it are written relative to the manifests: the repository, else the project's directory."""
    environment: Mapping[str, str]
    read: Callable[[Path], str | None]
    """The text of a file; None for one that is not there."""
    found: list[Diagnostic] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    private: set[str] = field(default_factory=set)
    aliases: dict[str, list[str]] = field(default_factory=dict)
    """Service -> names under which links of others know it."""

    def tell(self, severity: str, path: tuple[Step, ...], message: str, remedy: str = "") -> None:
        self.found.append(Diagnostic(self.project.where(*path), message, remedy, severity))

    def note(self, message: str, *path: Step, remedy: str = "") -> None:
        """How something was carried over."""
        self.tell(NOTE, path, message, remedy)

    def warn(self, message: str, *path: Step, remedy: str = "") -> None:
        """What is different from now on."""
        self.tell("warning", path, message, remedy)

    def refuse(self, message: str, *path: Step, remedy: str) -> None:
        """What cannot be carried over."""
        self.tell("error", path, message, remedy)

    def check(self, table: Mapping[str, Row], said: Mapping[str, Any], *path: Step, shown: str = "") -> None:
        """Tells of all keys of a section that are dropped or refused. `shown`: what stands before a key's name."""
        for key, value in said.items():
            if key.startswith("x-") or value in (None, {}, []):
                continue
            row = table.get(key)
            if row is None:
                self.refuse(f"{shown}{key} is no key that rorg knows", *path, key, remedy="dropping it")
            elif row.how == "dropped":
                self.note(f"{shown}{key} is not carried over: {row.why}", *path, key, remedy=row.remedy)
            elif row.how == "refused":
                self.refuse(f"{shown}{key} cannot be carried over: {row.why}", *path, key, remedy=row.remedy)

    def origin(self, *path: Step) -> str:
        """A place for a comment: its file beside the top, so that it is the same on every machine."""
        where = self.project.where(*path)
        file = os.path.relpath(where.file, self.top) if _below(where.file, self.top) else where.file
        return f"{file}:{where.line}:{where.column}"

    def local(self, path: str, folder: str = "services") -> str:
        """A path of this machine as a manifest in a folder of the tree writes it."""
        if not (_below(path, self.top) and _below(str(self.tree), self.top)):
            return path
        relative = os.path.relpath(path, self.tree / folder)
        return relative if relative.startswith("..") else f"./{relative}"

    def copies(self, service: str) -> int:
        """How many containers a service has."""
        said = self.project.services.get(service, {})
        deploy = said.get("deploy") or {}
        return int(said.get("scale", deploy.get("replicas", 1)))

    def called(self, section: str, name: str) -> str:
        """What services call a network or volume of the project: as in Compose, unless no manifest can be called so."""
        return name if len(name) > 1 and SOUND.fullmatch(name) else self.known(section, name)

    def known(self, section: str, name: str) -> str:
        """What the engine calls a network or volume of the project."""
        said = getattr(self.project, section).get(name) or {}
        return str(said.get("name") or (name if said.get("external") else f"{self.project.name}_{name}"))

    def first(self, service: str) -> str:
        """The Service that stands for one of Compose where one container is meant."""
        return f"{service}-1" if self.copies(service) > 1 else service


def _below(path: str, top: Path) -> bool:
    return path == str(top) or path.startswith(f"{top}/")


def size(value: Any) -> int | str:
    """Bytes, in the largest unit that is exact."""
    if not isinstance(value, int) or isinstance(value, bool):
        return str(value)
    return next((f"{value // unit}{name}" for name, unit in UNITS if value > 0 and value % unit == 0), value)


def duration(value: Any) -> str:
    """Seconds as a manifest writes them."""
    return format_duration(value) if isinstance(value, int | float) else str(value)
