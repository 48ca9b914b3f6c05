"""Compose projects that are imported, and what is told of them."""

from __future__ import annotations

from pathlib import Path

from rorg.manifest.yaml_text import plain
from rorg.tools.compose.load import load as read_project
from rorg.tools.importing.compose import from_compose
from rorg.tools.importing.manifests import Imported


def text_of(path: Path) -> str | None:
    return path.read_text() if path.is_file() else None


def imported(folder: Path, text: str = "", environment: dict[str, str] | None = None, **options) -> Imported:
    """Of compose.yaml in a folder, or of this text."""
    if text:
        (folder / "compose.yaml").write_text(text)
    environment = environment or {}
    loaded = read_project([folder / "compose.yaml"], environment, **options)
    assert loaded.project, loaded.diagnostics
    return from_compose(loaded.project, folder / "manifests", folder, text_of)


def spec(found: Imported, name: str = "nav", kind: str = "Service") -> dict:
    return plain(next(made.spec for made in found.manifests if (made.kind, made.name) == (kind, name)))


def told(found: Imported) -> list[str]:
    return [f"{d.where.line}:{d.where.column}: {d.severity}: {d.message}" for d in found.diagnostics]


def write(found: Imported, tree: Path) -> Path:
    for name, text in found.texts.items():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / name).write_text(text)
    return tree
