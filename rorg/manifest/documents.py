"""From files to checked documents: reads a tree, merges the overlay of a robot, fills in variables, checks the
envelopes."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from rorg.manifest.files import read_text
from rorg.manifest.hints import KINDS
from rorg.manifest.model_errors import mended, validated
from rorg.manifest.models import ENVELOPES, FOLDERS, SPECS, Manifest
from rorg.manifest.option_forms import Strict
from rorg.manifest.overlay import FOLDER, Written, laid_over, unknown_robot
from rorg.manifest.variables import NONE, Variables, fill, noted, read_variables, variable_files
from rorg.manifest.yaml_documents import read_documents
from rorg.manifest.yaml_source import MAX_ITEMS, Document, read_yaml
from rorg.manifest.yaml_source import Path as Loc
from rorg.model.diagnostics import Diagnostic, Reading, Where, collected, nearest, unknown

UNEXPECTED = "cannot be understood"


def unexpected(where: Where, bug: Exception) -> Diagnostic:
    """Reports an unexpected error in a file as its mistake, so that the robot keeps its last good manifests."""
    return Diagnostic(where, f"{UNEXPECTED} ({type(bug).__name__}: {str(bug)[:200]})", "to report this")


@dataclass(frozen=True)
class Source:
    """One manifest that is valid on its own: its document for positions, its spec for content."""

    document: Document
    kind: str
    name: str
    description: str
    labels: dict[str, str]
    spec: Any
    """The validated model of its kind, one of SPECS."""
    path: Path
    root: Path
    """The directory of the tree that it is in."""
    variables: Variables = field(default=NONE, compare=False)
    """The variables of the tree."""
    partial: bool = False
    """It has mistakes, and these are left out: what is missing in it may have been there."""
    several: bool = False
    """Its file has several documents."""

    def where(self, *path: str | int, key: bool = False) -> Where:
        return self.document.where(path, key)

    @cached_property
    def directory(self) -> Path:
        """The directory that its relative paths start from."""
        return beside(self.path, self.root)


def beside(path: Path, root: Path) -> Path:
    """The directory of a manifest; for a link, the directory of its target. The target is in the tree, because links
    that lead out of it are not read."""
    if not os.path.islink(path):
        return path.parent
    inner = os.path.relpath(os.path.realpath(path), os.path.realpath(root))
    return path.parent if inner.startswith("..") else (root / inner).parent


def manifest_files(root: Path) -> list[Path]:
    """Manifests of the base or of an overlay: root/*.yaml and root/KINDS/*.yaml. Deeper files configure services."""
    paths = [p for f in manifest_folders(root) if os.path.isdir(f) for p in f.iterdir()]
    # A dead link counts: an unreadable file is a mistake, not a removed service.
    return sorted(p for p in paths if p.suffix in (".yaml", ".yml") and not os.path.isdir(p))


def manifest_folders(root: Path) -> list[Path]:
    """The folders that may hold manifests."""
    return [root] + [root / folder for folder in FOLDERS]


def overlay_files(root: Path, robot: str) -> list[Path]:
    """Manifests of the overlay for one robot; none for the base alone."""
    return manifest_files(root / FOLDER / robot) if robot else []


def tree_files(root: Path, robot: str) -> list[Path]:
    """All files that declare a tree: manifests, the overlay of a robot, and existing files of variables."""
    variables = [path for path in variable_files(root, robot) if os.path.lexists(path)]
    return [*manifest_files(root), *overlay_files(root, robot), *variables]


def stray_files(root: Path) -> list[Path]:
    """YAML files in top-level folders that are not read."""
    folders = sorted(p for p in root.iterdir() if os.path.isdir(p) and p.name not in FOLDERS and p.name[0] != ".")
    return [path for folder in folders for path in sorted(folder.glob("*.y*ml"))]


def stray_manifests(root: Path) -> Iterator[Diagnostic]:
    """Reports manifests among the stray files: most likely the folder is misspelt."""
    for path in stray_files(root):
        if _is_manifest(path, root):
            message = f"a manifest in '{path.parent.name}/', which is not read"
            yield Diagnostic(Where(str(path)), message, f"folder {nearest(path.parent.name, FOLDERS)}")


def holds_manifests(root: Path) -> bool:
    """Whether a directory is a tree of manifests."""
    return any(_is_manifest(path, root) for path in manifest_files(root))


def _is_manifest(path: Path, root: Path) -> bool:
    with contextlib.suppress(OSError):
        return bool(re.search(r"^apiVersion: rorg/", read_text(path, root), re.M))
    return False


def read_tree(
    root: Path, edits: Mapping[Path, str | None] | None = None, robot: str = ""
) -> Reading[tuple[list[Source], set[str]]]:
    """Reads all manifests below `root`, with a robot's overlay merged in.

    Returns them with the names of the broken ones, so that a typo in one manifest is not reported as an unknown service
    elsewhere. Of a broken one that is YAML, the correct part is among the manifests, marked as partial.
    `edits` maps paths to new content, or to None for deleted files. Raises OSError for an unreadable tree.
    """
    edits = edits or {}
    paths = [path for path in dict.fromkeys([*manifest_files(root), *edits]) if edits.get(path, "") is not None]
    above = overlay_files(root, robot)
    yield from stray_manifests(root)
    base = yield from _written(paths, root, edits)
    over = yield from _written(above, root, edits)
    broken = {path.stem for path in {*paths, *above} - {written.path for written in (*base, *over)}}
    documents = yield from laid_over(base, over)
    variables = yield from read_variables(root, robot)
    yield from filter(None, [unknown_robot(root, robot)])
    sources: list[Source] = []
    for written in documents:
        try:
            source, diagnostics = check_source(written, root, variables)
        except Exception as bug:
            source, diagnostics = None, [unexpected(Where(str(written.path)), bug)]
        yield from diagnostics
        if source:
            yield from () if written.several else _misplaced(source, (root, root / FOLDER / robot))
            sources.append(source)
        if source is None or source.partial:
            broken |= set() if written.several else {written.path.stem}
            broken |= {*re.findall(r"^ +name: *['\"]?([A-Za-z0-9_.-]+)", written.text, re.M)[:1]}
    return sources, broken


def _written(paths: Iterable[Path], root: Path, edits: Mapping[Path, str | None]) -> Reading[list[Written]]:
    """Reads files as YAML, and reports unreadable ones."""
    written = []
    for path in paths:
        try:
            text = edits.get(path)
            text = read_text(path, root) if text is None else text
            documents = read_documents(text, str(path), items=MAX_ITEMS)
            written += [Written(path, *document, several=len(documents) > 1) for document in documents]
        except OSError as error:
            yield Diagnostic(Where(str(path)), f"cannot be read: {error.strerror}", "to fix or delete it")
        except Exception as bug:
            written.append(Written(path, str(text), None, [unexpected(Where(str(path)), bug)]))
    return written


def _misplaced(source: Source, tops: Collection[Path]) -> Iterator[Diagnostic]:
    """Reports a file in the folder of another kind. One with several documents may hold any kinds."""
    folder = source.path.parent
    if folder not in tops and FOLDERS.get(folder.name, source.kind) != source.kind:
        right = next(f for f, kind in FOLDERS.items() if kind == source.kind)
        yield Diagnostic(source.where("kind"), f"a {source.kind} in '{folder.name}/'", f"folder '{right}'")


def read_source(
    text: str, path: Path, file: str, root: Path, variables: Variables = NONE
) -> tuple[Source | None, list[Diagnostic]]:
    """Reads one file's manifest; None with the reasons if it is invalid. `variables` are those of the tree."""
    source, diagnostics = check_source(Written(path, text, *read_yaml(text, file, items=MAX_ITEMS)), root, variables)
    return None if diagnostics else source, diagnostics


def check_source(written: Written, root: Path, variables: Variables = NONE) -> tuple[Source | None, list[Diagnostic]]:
    """Checks one document; returns a partial source if only a part of it is valid."""
    if written.document is None:
        return None, list(written.found)
    document, unset = fill(written.document, variables)
    before = [*written.found, *unset]
    told = {d.where for d in before}  # report one mistake at one place
    source, more = collected(_checked(document, written.path, root, variables))
    diagnostics = [*before, *(d for d in more if d.where not in told)]
    if any(d.code != "duplicate-key" for d in written.found):
        source = None  # values that YAML cannot give, such as a NUL character in a path, are no values to check
    source = replace(source, partial=bool(diagnostics), several=written.several) if source else None
    return source, noted(diagnostics, [document])


BESIDE = {"Trace": "`rorg simulate FILE` reads it", "Workload": "`rorg simulate TRACE --workload FILE` reads it"}
"""Kinds of documents outside a tree, and what reads them."""


def _checked(document: Document, path: Path, root: Path, variables: Variables) -> Reading[Source | None]:
    if not isinstance(document.value, dict):
        message = "a manifest must be a mapping with apiVersion, kind, metadata, spec"
        yield Diagnostic(document.where(()), message)
        return None
    kind = document.value.get("kind")
    form = ENVELOPES.get(kind, Manifest) if isinstance(kind, str) else Manifest
    envelope, _ = yield from _valid(form, document, document.value, ())
    if isinstance(kind, str) and kind in BESIDE:
        message = f"a {kind} does not describe a robot and cannot be part of its tree"
        yield Diagnostic(document.where(("kind",)), message, f"to move it out: {BESIDE[kind]}")
    elif isinstance(kind, str) and kind not in SPECS:
        diagnostic = unknown(document.where(("kind",)), "kind", kind, SPECS)
        yield replace(diagnostic, remedy=KINDS[kind]) if kind in KINDS else diagnostic
    if not isinstance(kind, str) or kind not in SPECS or "spec" not in document.value:
        return None
    spec, document = yield from _valid(SPECS[kind], document, document.value["spec"], ("spec",))
    if envelope is None or spec is None:
        return None
    meta = envelope.metadata
    return Source(document, kind, meta.name, meta.description or "", dict(meta.labels), spec, path, root, variables)


def _valid(model: type[Strict], document: Document, value: object, at: Loc) -> Reading[tuple[Any, Document]]:
    """Validates a value, without its mistakes if it has some; None if too little is left. Also returns the document
    without what was dropped from its lists."""
    read, diagnostics = validated(model, document, value, at)
    if diagnostics:
        read, document, more = mended(model, document, value, at, diagnostics)
        diagnostics += more
    yield from diagnostics
    return read, document
