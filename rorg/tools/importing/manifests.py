"""The result of an import: manifests and other files as texts, with findings about them; and writing it.

A new directory appears complete or not at all. Whole files are moved into an existing one, one after the
other, once all of them are on the disk."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rorg.manifest.files import real
from rorg.manifest.models import API_VERSION
from rorg.manifest.schema import write as write_schemas
from rorg.manifest.yaml_text import one_line, yaml_text
from rorg.model.diagnostics import Diagnostic
from rorg.model.image_names import stem
from rorg.store.files import sync

FOLDERS = {
    "Service": "services",
    "Group": "groups",
    "Image": "images",
    "Profile": "profiles",
    "Network": "networks",
    "Volume": "volumes",
    "Request": "requests",
}
"""Kind -> the folder of its manifests."""
NOTE = "note"
"""Severity of a finding about how something was carried over. A warning is about a difference."""


@dataclass(frozen=True)
class Made:
    """One manifest."""

    kind: str
    name: str
    spec: Mapping[str, Any]
    """Plain values, some with a comment (yaml_text.Noted)."""
    comments: tuple[str, ...] = ()
    """Lines above the document; the first says where it came from."""
    labels: Mapping[str, str] = field(default_factory=dict)
    description: str = ""

    @property
    def path(self) -> str:
        """Its path in a tree of manifests."""
        return f"{FOLDERS[self.kind]}/{stem(self.name)}.yaml"

    @property
    def text(self) -> str:
        """The whole file."""
        head = [f"yaml-language-server: $schema=../schemas/{self.kind.lower()}.json", *map(one_line, self.comments)]
        metadata: dict[str, Any] = {"name": self.name}
        if self.description:
            metadata["description"] = self.description
        if self.labels:
            metadata["labels"] = self.labels
        document = {"apiVersion": API_VERSION, "kind": self.kind, "metadata": metadata, "spec": self.spec}
        return "".join(f"# {line}\n" for line in head) + yaml_text(document)


@dataclass(frozen=True)
class Imported:
    """The result of an import. It must not be written if there are errors."""

    manifests: tuple[Made, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    """Other files: path in the tree -> text."""
    private: frozenset[str] = frozenset()
    """Those of `files` that only their owner may read."""
    diagnostics: tuple[Diagnostic, ...] = ()

    def with_diagnostics(self, more: Iterable[Diagnostic]) -> Imported:
        """The same result, with earlier findings added."""
        return replace(self, diagnostics=tuple(sorted({*self.diagnostics, *more})))

    @property
    def errors(self) -> tuple[Diagnostic, ...]:
        """The findings that prevent writing."""
        return tuple(d for d in self.diagnostics if d.severity == "error")

    @property
    def texts(self) -> dict[str, str]:
        """Every file of the tree: path -> text, in order."""
        return {**{made.path: made.text for made in self.manifests}, **self.files}


def manifest_name(text: str) -> str:
    """A valid name of a manifest, from the name of a file or a node."""
    name = re.sub(r"[^A-Za-z0-9_.-]", "-", text).strip("._-")[:60]
    return name if len(name) > 1 else f"{name}-launch".lstrip("-")


_PART = re.compile(r"\..*\.part([0-9]+)")
"""The name of an unfinished directory. A killed import leaves one behind; the next import removes it."""


def existing_files(imported: Imported, output: Path) -> list[Path]:
    """Existing files that would be overwritten."""
    return [output / name for name in imported.texts if os.path.lexists(output / name)]


def write_tree(imported: Imported, output: Path) -> None:
    """Writes all files of an import, and the schemas of manifests. On OSError, nothing but the last file written may
    have changed."""
    for name in imported.texts:
        if not real((output / name).parent).is_relative_to(real(output)):
            raise OSError(errno.EPERM, "it leads out of the directory", str(output / name))
    fresh = not os.path.lexists(output)
    around = output.absolute().parent if fresh else output
    around.mkdir(parents=True, exist_ok=True)
    _clear(around)
    part = around / f".{output.absolute().name}.part{os.getpid()}"
    part.mkdir()
    try:
        _fill(part, imported)
        for path in (*part.rglob("*"), part):
            sync(path)
        if fresh:
            part.rename(output)
            sync(around)
        else:
            _move(sorted(p.relative_to(part) for p in part.rglob("*") if not p.is_dir()), part, output)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _fill(part: Path, imported: Imported) -> None:
    for name, text in imported.texts.items():
        path = part / name
        path.parent.mkdir(parents=True, exist_ok=True)
        mode = 0o600 if name in imported.private else 0o666
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
        with open(descriptor, "w", encoding="utf-8") as file:
            file.write(text)
    write_schemas(part / "schemas", check=False)


def _move(names: Iterable[Path], part: Path, output: Path) -> None:
    for name in names:
        (output / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(part / name, output / name)
        sync((output / name).parent)


def _clear(folder: Path) -> None:
    """Removes what killed imports left behind."""
    for path in folder.glob(".*"):
        match = _PART.fullmatch(path.name)
        if match and path.is_dir() and not path.is_symlink() and not os.path.exists(f"/proc/{match[1]}"):
            shutil.rmtree(path, ignore_errors=True)
