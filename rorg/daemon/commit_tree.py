"""Reads the tree of an earlier commit as if it were the current one."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from rorg.core.desired import Desired, desire
from rorg.daemon.tree import Tree
from rorg.errors import Invalid, RorgError, Unreachable
from rorg.host import contents
from rorg.host.git_tree import Mirror, extracted, resolved
from rorg.images import identity
from rorg.images.context import context_files
from rorg.images.references import Content
from rorg.manifest.documents import stray_files, tree_files
from rorg.manifest.inputs import Inputs
from rorg.manifest.load import fingerprint, load
from rorg.manifest.overlay import robot_for
from rorg.model.catalog import Catalog, Image
from rorg.model.units import counted


@dataclass(frozen=True, slots=True)
class CommitTree:
    """The manifests of a commit, with the files that they name. Paths are those of the tree, contents those of the
    commit; files that git does not know count as they are now."""

    commit: str
    """In full."""
    desired: Desired
    images: Content

    @property
    def catalog(self) -> Catalog:
        return self.desired.catalog


def load_at(tree: Tree, rev: str) -> CommitTree:
    """Load the state that `rev` names, for the engine and the robot of a tree; the tree itself is not read.

    Raises Invalid if there is no such state, or if its manifests have errors (each with its place as git writes it:
    abc1234:services/a.yaml), and Unreachable if git does not answer.
    """
    root = tree.root.resolve()
    commit = resolved(root, rev)
    with extracted(root, commit) as mirror, _named(mirror):
        there = mirror.at(root)
        if not there.is_dir():
            raise Invalid(f"read the manifests of '{rev}'", f"{commit[:7]} has no {root.name}/ there", "a later commit")
        manifests = [*tree_files(root, tree.robot), *stray_files(root)]
        mirror.bring(manifests, contents.MOST_FILES, contents.MOST_BYTES)
        robot = robot_for(there, tree.named, tree.host)
        loaded = load(there, on_inputs=lambda inputs: _bring_inputs(mirror, inputs), engine=tree.engine, robot=robot)
        tree.masker.learn(loaded.read)
        if loaded.catalog is None:
            lines = "\n".join(map(str, loaded.errors))
            why = f"{counted(len(loaded.errors), 'error')}\n{lines}\n"
            raise Invalid(f"use the manifests of '{rev}'", why, "another commit")
        _bring_contexts(mirror, loaded.catalog.images)
        images = tree.references.of(loaded.catalog) if tree.references else Content()
        digests = contents.Contents().of(loaded.catalog, there)
        catalog = _relocated(loaded.catalog, lambda text: text.replace(str(mirror.place), ""))
    catalog = replace(catalog, fingerprint=fingerprint(catalog))
    return CommitTree(commit, desire(catalog, tree.run, digests, images.references), images)


@contextmanager
def _named(mirror: Mirror) -> Iterator[None]:
    """Name places in the commit, instead of those in the mirror, in errors of the block."""
    try:
        yield
    except RorgError as error:
        raise type(error)(*map(mirror.name, (error.what, error.why, error.remedy))) from error
    except OSError as error:
        raise Unreachable(f"read the manifests of {mirror.commit[:7]}", mirror.name(str(error))) from error


def _bring_inputs(mirror: Mirror, inputs: Inputs) -> None:
    """Bring files that git does not know and that are read with the manifests, or mounted."""
    # One by one, so that a large file does not keep the others away.
    for place in _here(mirror, (*inputs.files, *inputs.contexts)):
        mirror.bring([place], 1, contents.MOST_BYTES)
    for place in _here(mirror, inputs.mounted):
        mirror.bring([place], 1, contents.MOST_BYTES)
        mirror.bring((Path(path) for path, _ in contents.walk(str(place))), contents.MOST_FILES, contents.MOST_BYTES)


def _bring_contexts(mirror: Mirror, images: Mapping[str, Image]) -> None:
    """Bring files that git does not know and that images are built from."""
    for image in images.values():
        named = [Path(image.directory, word) for word in image.import_command or ()]
        mirror.bring(_here(mirror, named), identity.MOST_FILES, identity.MOST_BYTES)
        if image.context is not None:
            mirror.bring(_context(mirror, Path(image.context), image), identity.MOST_FILES, identity.MOST_BYTES)


def _context(mirror: Mirror, place: Path, image: Image) -> Iterator[Path]:
    """The files that are in a context now, by the commit's .dockerignore."""
    here = mirror.real(place)
    with suppress(OSError):
        yield from (here / name for name, _ in context_files(here, image.dockerfile, place))


def _here(mirror: Mirror, places: Iterable[Path]) -> list[Path]:
    """The files of this machine that places of the mirror stand for."""
    plain = (Path(os.path.normpath(place)) for place in places)
    return sorted(mirror.real(place) for place in plain if place.is_relative_to(mirror.place))


def _relocated(value: Any, change: Callable[[str], str]) -> Any:
    """The same value with all its texts changed."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        return {key: _relocated(entry, change) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        entries = [_relocated(entry, change) for entry in value]
        return entries if isinstance(value, list) else tuple(entries)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{f.name: _relocated(getattr(value, f.name), change) for f in fields(value)})
    return value
