"""Overlays: documents of robots/NAME/ merged into the base of a tree for one robot.

A document with the kind and name of one in the base is merged into it: mappings key by key; anything else, lists too,
is replaced; null deletes a key of the base. Other documents are added. `removed: true` beside the metadata deletes a
document of the base. Relative paths start from the manifest of the base, like Compose with several files.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rorg.manifest.yaml_documents import key_of
from rorg.manifest.yaml_source import Document
from rorg.manifest.yaml_source import Path as Loc
from rorg.model.diagnostics import Diagnostic, Reading, Where, nearest

FOLDER = "robots"
REMOVED = "removed"


@dataclass
class Written:
    """A document of the tree as it is written, before its kind is known."""

    path: Path
    text: str
    document: Document | None
    """None if it is not YAML."""
    found: list[Diagnostic] = field(default_factory=list)
    """Mistakes in its YAML."""
    several: bool = False
    """Its file has several documents."""

    @property
    def key(self) -> tuple[str, str]:
        """(kind, name); empty if it has none."""
        return key_of(self.document)


def robots_of(root: Path) -> list[str]:
    """The robots of a tree that have an overlay."""
    try:
        return sorted(p.name for p in (root / FOLDER).iterdir() if p.is_dir() and p.name[0] != ".")
    except OSError:
        return []


def robot_for(root: Path, named: str, host: str) -> str:
    """The robot to read a tree for: the one that is named, else the one with the name of this machine (`host`, with or
    without its domain) if it has an overlay; empty for the base alone."""
    if named or not host:
        return named
    known = robots_of(root)
    return next((name for name in (host, host.partition(".")[0]) if name in known), "")


def unknown_robot(root: Path, robot: str) -> Diagnostic | None:
    """Reports a robot without an overlay in the tree; None if it has one or if no robot is given."""
    known = robots_of(root)
    if not robot or robot in known:
        return None
    remedy = nearest(robot, known) or f"to create {FOLDER}/{robot}/"
    return Diagnostic(Where(str(root / FOLDER)), f"no robot '{robot}'", remedy)


def laid_over(base: Iterable[Written], over: Iterable[Written]) -> Reading[list[Written]]:
    """Merges an overlay into the base; returns the documents of the robot."""
    documents = dict(enumerate(base))
    for upper in over:
        place = next((n for n, w in documents.items() if w.key == upper.key != ("", "")), None)
        value = upper.document.value if upper.document else None
        lower = documents[place] if place is not None else None
        if isinstance(value, dict) and value.get(REMOVED) is True:
            if place is not None:
                del documents[place]
            else:
                yield _nothing_to_remove(upper, documents.values())
            yield from upper.found
        elif place is None or lower is None or upper.document is None or lower.document is None:
            documents[max(documents, default=0) + 1] = upper
        else:
            merged = merge(lower.document, upper.document)
            documents[place] = replace(lower, document=merged, found=[*lower.found, *upper.found])
    return list(documents.values())


def _nothing_to_remove(upper: Written, documents: Iterable[Written]) -> Diagnostic:
    kind, name = upper.key
    assert upper.document is not None
    known = [w.key[1] for w in documents if w.key[0] == kind and kind]
    where = upper.document.where(("metadata", "name"))
    return Diagnostic(where, f"there is no {kind or 'document'} '{name}' to be removed", nearest(name, known))


def merge(base: Document, over: Document) -> Document:
    """Merges two documents. Every value keeps the file that it comes from."""
    allows = (*base.allows, *over.allows)
    merged = Document(base.file, None, dict(base.keys), dict(base.values), dict(base.files), allows)
    merged.value = _merged(merged, over, base.value, over.value, ())
    return merged


def _merged(merged: Document, over: Document, old: Any, new: Any, at: Loc) -> Any:
    if not (isinstance(old, dict) and isinstance(new, dict)):
        _forget(merged, at)
        _take(merged, over, at)
        return new
    result = dict(old)
    for key, value in new.items():
        path = (*at, key)
        if value is None:
            result.pop(key, None)
            _forget(merged, path)
        elif key in old:
            result[key] = _merged(merged, over, old[key], value, path)
        else:
            result[key] = value
            _take(merged, over, path)
    return result


def _forget(document: Document, at: Loc) -> None:
    for places in (document.keys, document.values, document.files):
        for path in [p for p in places if p[: len(at)] == at]:
            del places[path]


def _take(merged: Document, over: Document, at: Loc) -> None:
    for mine, theirs in ((merged.keys, over.keys), (merged.values, over.values)):
        new = {p: place for p, place in theirs.items() if p[: len(at)] == at}
        mine.update(new)
        merged.files.update(dict.fromkeys(new, over.file))
