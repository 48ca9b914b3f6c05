"""The texts of a tree's manifests, and whether another one may stand in the place of one of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rorg.core.masking import MASK, Masker
from rorg.errors import Invalid
from rorg.manifest.documents import manifest_files
from rorg.manifest.files import read_bytes
from rorg.manifest.load import Loaded, load
from rorg.manifest.yaml_source import read_yaml

MOST = 5
"""Mistakes that one error names."""


def manifests_of(root: Path) -> dict[tuple[str, str], tuple[Path, bytes]]:
    """(kind, name) -> file and content, of every manifest that can be read at all."""
    found = {}
    for path in manifest_files(root):
        try:
            content = read_bytes(path, root)
        except OSError:  # it says so where manifests are loaded; or it has just gone
            continue
        document, _ = read_yaml(content.decode("utf-8", errors="replace"), str(path))
        value = document.value if document else None
        if isinstance(value, dict) and isinstance(value.get("metadata"), dict):
            found[str(value.get("kind")), str(value["metadata"].get("name"))] = path, content
    return found


def check_name(kind: str, name: str, text: str) -> None:
    """Raises Invalid for a text that declares something else. What cannot be read says so in the tree."""
    document, _ = read_yaml(text, name)
    value: Any = document.value if document else None
    metadata = value.get("metadata") if isinstance(value, dict) else None
    if isinstance(metadata, dict) and (value.get("kind"), metadata.get("name")) != (kind, name):
        raise Invalid(f"change the {kind} '{name}'", "the text is of another kind or name", "its own address")


def check_tree(
    root: Path, path: Path, text: str | None, engine: str, what: str, robot: str = "", stranger: bool = False
) -> tuple[Loaded, Loaded]:
    """A tree that runs on an engine, for a robot, before and after a text comes in the place of a file (None: no file).
    Raises Invalid for mistakes that it would bring. A `stranger` is told of those in other files only where they are:
    their texts may cite what it may not read."""
    before = load(root, engine=engine, robot=robot)
    after = load(root, {path: text}, engine=engine, robot=robot)
    known = {str(d) for d in before.errors}
    errors = [d for d in after.errors if str(d) not in known]
    if errors:
        told = [f"{d.where}: an error" if stranger and d.where.file != str(path) else str(d) for d in errors[:MOST]]
        raise Invalid(what, "; ".join(told).replace(f"{root}/", ""))
    return before, after


def restored(before: str, text: str, masker: Masker, what: str) -> str:
    """A text that somebody made of the one before, as it was shown to them: a line that was shown with a secret hidden,
    and came back as it was, is what it stands for. Raises Invalid where that cannot be told."""
    shown = masker.text(before)
    if shown == before or MASK not in text:
        return text
    hidden = [(s.strip(), b.strip()) for s, b in zip(shown.split("\n"), before.split("\n"), strict=False) if MASK in s]
    lines = text.split("\n")
    back = [(number, line.strip()) for number, line in enumerate(lines) if MASK in line]
    whole = [line for _, line in back] == [line for line, _ in hidden]
    for index, (number, line) in enumerate(back):
        meant = {hidden[index][1]} if whole else {b for s, b in hidden if s == line}
        if len(meant) != 1:
            why = f"in line {number + 1}, {MASK} stands for a secret that is not shown"
            raise Invalid(what, why, "writing its value there, or leaving the line as it was")
        lines[number] = lines[number].replace(line, meant.pop(), 1)
    return "\n".join(lines)
