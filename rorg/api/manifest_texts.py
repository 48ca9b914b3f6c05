"""The texts of a tree's manifests, and the checks of a text that is to replace one of them."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any, NamedTuple

from rorg.api.manifest_change import digest
from rorg.core.masking import MASK, Masker
from rorg.errors import Invalid
from rorg.manifest.documents import manifest_files
from rorg.manifest.files import read_bytes
from rorg.manifest.load import Loaded, load
from rorg.manifest.yaml_documents import document_texts, read_documents, with_document
from rorg.manifest.yaml_source import read_yaml

MOST = 5
"""Mistakes that one error names."""


class Kept(NamedTuple):
    """A manifest of a tree: its file, its text, and the content of the file, which may have other documents."""

    path: Path
    text: bytes
    content: bytes


def manifests_of(root: Path) -> dict[tuple[str, str], Kept]:
    """(kind, name) -> every manifest that can be read at all."""
    manifests: dict[tuple[str, str], Kept] = {}
    for path in manifest_files(root):
        with contextlib.suppress(OSError):  # loading the manifests reports it; or the file has just gone
            manifests |= manifests_in(path, read_bytes(path, root))
    return manifests


def manifests_in(path: Path, content: bytes) -> dict[tuple[str, str], Kept]:
    """(kind, name) -> every manifest of a file."""
    manifests, documents = {}, read_documents(content.decode("utf-8", errors="replace"), str(path))
    for text, document, _ in documents:
        value = document.value if document else None
        if isinstance(value, dict) and isinstance(value.get("metadata"), dict):
            alone = content if len(documents) == 1 else text.encode()
            manifests[str(value.get("kind")), str(value["metadata"].get("name"))] = Kept(path, alone, content)
    return manifests


def file_with(kept: Kept, kind: str, name: str, text: str | None) -> str | None:
    """The text of the whole file after a text replaces one manifest (None: deletes it); None if nothing is left."""
    if kept.text == kept.content:
        return text
    return with_document(kept.content.decode("utf-8", errors="replace"), (kind, name), text)


def listed(root: Path) -> list[dict[str, Any]]:
    """All manifests of a tree, as ManifestView."""
    return [
        {"kind": kind, "name": name, "file": str(kept.path.relative_to(root)), "digest": digest(kept.text)}
        for (kind, name), kept in sorted(manifests_of(root).items())
    ]


def check_name(kind: str, name: str, text: str) -> None:
    """Raises Invalid for a text that declares something else. A text that cannot be read is an error of the tree."""
    if (count := len(document_texts(text))) > 1:
        raise Invalid(f"change the {kind} '{name}'", f"the text has {count} documents", "to send one at a time")
    document, _ = read_yaml(text, name)
    value: Any = document.value if document else None
    metadata = value.get("metadata") if isinstance(value, dict) else None
    if isinstance(metadata, dict) and (value.get("kind"), metadata.get("name")) != (kind, name):
        raise Invalid(f"change the {kind} '{name}'", "the text is of another kind or name", "its own address")


def check_tree(
    root: Path, path: Path, text: str | None, *, engine: str, what: str, robot: str = "", stranger: bool = False
) -> tuple[Loaded, Loaded]:
    """Loads a tree for an engine and a robot, before and after a text replaces a file (None: deletes it). Raises
    Invalid for mistakes that this adds. A `stranger` gets only the place of mistakes in other files: their texts may
    quote what it may not read."""
    before = load(root, engine=engine, robot=robot)
    after = load(root, {path: text}, engine=engine, robot=robot)
    known = {str(d) for d in before.errors}
    errors = [d for d in after.errors if str(d) not in known]
    if errors:
        told = [f"{d.where}: an error" if stranger and d.where.file != str(path) else str(d) for d in errors[:MOST]]
        raise Invalid(what, "; ".join(told).replace(f"{root}/", ""))
    return before, after


def restored(before: str, text: str, masker: Masker, what: str) -> str:
    """The text that a person or service edited while it saw secrets masked, with the secrets in place again: an
    unchanged line with a mask stands for the original line. Raises Invalid if that is ambiguous."""
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
            raise Invalid(what, why, "to write its value there, or leave the line as it was")
        lines[number] = lines[number].replace(line, meant.pop(), 1)
    return "\n".join(lines)
