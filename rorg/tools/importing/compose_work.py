"""What all parts of an import from Compose share: the project, the destination, and the findings."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rorg.errors import advice
from rorg.model.diagnostics import Diagnostic
from rorg.tools.compose.project import Project
from rorg.tools.importing.compose_keys import Row
from rorg.tools.importing.manifests import NOTE

UNITS = (("Gi", 1 << 30), ("Mi", 1 << 20), ("Ki", 1 << 10))
SOUND = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9_.-]{0,61}[A-Za-z0-9_-])?")
"""Valid names of manifests."""
Step = str | int


@dataclass
class Work:
    """One import."""

    project: Project
    tree: Path
    """Absolute directory of the manifests."""
    top: Path
    """Paths below it are written relative to the manifests: the repository, or the project's directory."""
    read: Callable[[Path], str | None]
    """The text of a file; None if it does not exist."""
    skip: bool = False
    """Leave out what cannot be carried over, with a warning instead of an error."""
    found: list[Diagnostic] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    private: set[str] = field(default_factory=set)
    aliases: dict[str, list[str]] = field(default_factory=dict)
    """Service -> names under which links of other services know it."""

    unbuilt: dict[str, list[str]] = field(default_factory=dict)
    """Service -> comments on why nothing builds its image."""
    renamed: dict[str, str] = field(default_factory=dict)
    """Service -> its container's name, if another service has the one that it declares."""
    rivals: dict[str, list[str]] = field(default_factory=dict)
    """Service -> services that declare the same name of a container before it."""

    def tell(self, severity: str, path: tuple[Step, ...], message: str, remedy: str = "") -> None:
        self.found.append(Diagnostic(self.project.where(*path), message, remedy, severity))

    def note(self, message: str, *path: Step, remedy: str = "") -> None:
        """Notes how something was carried over."""
        self.tell(NOTE, path, message, remedy)

    def warn(self, message: str, *path: Step, remedy: str = "") -> None:
        """Warns of a difference."""
        self.tell("warning", path, message, remedy)

    def refuse(self, message: str, *path: Step, remedy: str) -> None:
        """Reports something that cannot be carried over."""
        if self.skip:
            self.tell("warning", path, f"skipped: {message}", remedy)
        else:
            self.tell("error", path, message, remedy)

    def told(self, before: int) -> list[str]:
        """All findings after the first `before` ones that are not errors, as comments of a manifest."""
        diagnostics = [d for d in self.found[before:] if d.severity != "error"]
        return [d.message + advice(d.remedy) for d in diagnostics]

    def check(self, table: Mapping[str, Row], said: Mapping[str, Any], *path: Step, shown: str = "") -> None:
        """Reports all keys of a section that are dropped or refused. `shown`: prefix of the keys in messages."""
        for key in (key for key, value in said.items() if not key.startswith("x-") and value not in (None, {}, [])):
            row = table.get(key)
            if row is None:
                self.refuse(f"{shown}{key} is unknown to rorg", *path, key, remedy="to drop it")
            elif row.how == "dropped":
                self.note(f"{shown}{key} is not carried over: {row.why}", *path, key, remedy=row.remedy)
            elif row.how == "refused":
                self.refuse(f"{shown}{key} cannot be carried over: {row.why}", *path, key, remedy=row.remedy)

    def origin(self, *path: Step) -> str:
        """A place for a comment. Its file is relative to the top, so that it is the same on every machine."""
        where = self.project.where(*path)
        file = os.path.relpath(where.file, self.top) if _below(where.file, self.top) else where.file
        return f"{file}:{where.line}:{where.column}"

    def local(self, path: str, folder: str = "services") -> str:
        """A path of this machine as a manifest in `folder` writes it."""
        if not (_below(path, self.top) and _below(str(self.tree), self.top)):
            return path
        relative = os.path.relpath(path, self.tree / folder)
        return relative if relative.startswith("..") else f"./{relative}"

    def copies(self, service: str) -> int:
        """The number of containers of a service."""
        said = self.project.services.get(service, {})
        deploy = said.get("deploy") or {}
        return int(said.get("scale", deploy.get("replicas", 1)))

    def called(self, section: str, name: str) -> str:
        """The name of a network or volume in manifests: as in Compose, unless that is not a valid name there."""
        return name if len(name) > 1 and SOUND.fullmatch(name) else self.known(section, name)

    def known(self, section: str, name: str) -> str:
        """The engine's name of a network or volume of the project."""
        said = getattr(self.project, section).get(name) or {}
        return str(said.get("name") or (name if said.get("external") else f"{self.project.name}_{name}"))

    def first(self, service: str) -> str:
        """The first copy of a service, for options that mean exactly one container."""
        return f"{service}-1" if self.copies(service) > 1 else service


def _below(path: str, top: Path) -> bool:
    return path == str(top) or path.startswith(f"{top}/")


def size(value: int) -> int | str:
    """Bytes, in the largest exact unit."""
    return next((f"{value // unit}{name}" for name, unit in UNITS if value > 0 and value % unit == 0), value)


def nonempty(value: Mapping[str, Any]) -> dict[str, Any]:
    """The entries that say something."""
    return {key: item for key, item in value.items() if item not in (None, "", {}, [])}
