"""The tree of manifests as the loop sees it: read again after a change, never half written. The last good one is
kept."""

from __future__ import annotations

import contextlib
import itertools
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from rorg.core.desired import Desired, desire, desire_again
from rorg.core.masking import Masker
from rorg.core.peers import seen_from
from rorg.core.standing import Standing
from rorg.daemon.git_source import GitSource
from rorg.daemon.tree_changes import TreeChanges
from rorg.errors import RorgError
from rorg.host.contents import Contents, Stats, below, contexts, stats
from rorg.host.git import Commit, checkout_under_way, git_dir, head, head_stamp, refusal
from rorg.images.references import Content, References
from rorg.manifest.documents import beside, manifest_files, manifest_folders, stray_files, tree_files, unexpected
from rorg.manifest.inputs import Inputs
from rorg.manifest.load import Loaded, load
from rorg.manifest.machines import machine_for
from rorg.manifest.overlay import FOLDER, robot_for
from rorg.model.catalog import EMPTY, Catalog
from rorg.model.diagnostics import Diagnostic, Where

PATIENCE = 2.0
"""Seconds to wait for a tree that changes while it is read; after that it is read as it is."""
CHECKOUT = 60.0
"""The same while git says that it writes the tree."""
Stamp = tuple[Stats, Stats, Stats]
MOST_FOLDERS = 4000
"""Directories that are watched: the kernel has few watches, and other programs need some too."""


class Tree:
    """`desired` is what the last good tree declares. While there are `errors` nothing is removed because of it."""

    refusal = ""
    """Why git refuses to answer."""
    errors: tuple[Diagnostic, ...] = ()
    warnings: tuple[Diagnostic, ...] = ()
    loaded = False
    """Whether any tree has been good yet."""
    standing: Standing | None = None
    """The standing of its revision, as of the last pass."""
    _catalog: Catalog | None = None
    """The last good tree, as it was read."""
    _records: tuple[int, ...] = ()
    """The stamp of the record of builds at that time."""
    overtaken = False
    """Whether `commit` may be a later one than the one that was read: the repository has moved since then."""
    here = ""  # which machine of the robot this is, if it has several
    _commit: tuple[object, Commit | None] | None = None
    """(the repository's head when git was asked, git's answer)."""
    _moves: tuple[tuple[int, int], ...] = ()
    """The repository's head at the last reading."""
    _stamp: Stamp | None = None
    """The stamp of the last reading."""
    _since: float | None = None
    """Since when the tree has been too busy to be read."""
    _seen: Stamp | None = None
    """The stamp at the last look since then."""

    def __init__(
        self,
        root: Path,
        run: str = "/run/rorg",
        clock: Callable[[], float] = time.monotonic,
        *,
        engine: str = "",
        references: References | None = None,
        named: str = "",
        host: str = "",
        source: GitSource | None = None,
        machine: str = "",
        adapt: Callable[[Catalog], Catalog] = lambda catalog: catalog,
        last: Callable[[], Catalog | None] = lambda: None,
    ) -> None:
        """`named`, `machine`: the robot whose overlay is used, and which of its machines this is; by default those
        called `host`. `adapt`: changes what was read into what runs, such as stand-ins for its programs. `last`: the
        Catalog that was in force before this rorg, with which it begins if the tree has errors. A mistake in a file
        and then a reboot must not leave the robot without its services."""
        self.named, self.host, self.machine = named, host, machine
        self.root, self.run, self.clock, self.engine = root, run, clock, engine
        self.references, self.source, self.adapt, self.last = references, source, adapt, last
        self.masker = Masker()
        """Knows the secrets of everything that was read, even of refused trees."""
        self.images = Content()
        """Of the last good tree."""
        self.desired: Desired = desire(EMPTY)
        self._inputs, self._contents = Inputs(), Contents()
        self.changes = TreeChanges()

    @cached_property
    def _git(self) -> Path | None:
        return self.source.cache.store if self.source else git_dir(self.root)

    @property
    def robot(self) -> str:
        """The robot whose overlay is applied; empty for the base alone."""
        return robot_for(self.root, self.named, self.host)

    @property
    def removals(self) -> bool:
        """Whether the removal of undeclared services may be planned."""
        return self.loaded and not self.errors

    @property
    def commit(self) -> Commit | None:
        """The commit of what was read last."""
        stamp = (self._stamp, self._moves)
        if self._commit is None or self._commit[0] != stamp:
            self._commit = stamp, head(self.root) if self._git else None
            self.overtaken = head_stamp(self._git) != self._moves
            self.refusal = refusal(self.root) if self._commit[1] is None else ""
        return self._commit[1]

    @property
    def revision(self) -> str:
        """Its short name: the abbreviated commit, with `+` if files differ from it."""
        commit = self.commit if self.loaded else None
        return commit.commit[:7] + "+" * commit.dirty if commit else ""

    @property
    def busy(self) -> bool:
        """Whether the tree is being written, so that reading it must wait."""
        return self._since is not None or (self.source is not None and self.source.writing)

    @property
    def _under_way(self) -> bool:
        """Whether git is writing it."""
        return checkout_under_way(self._git) or (self.source is not None and self.source.writing)

    def stamp(self) -> Stamp:
        """Changes with every file that belongs to the tree (names, times, sizes): manifests, what is read with them,
        and what is mounted. Other files below it do not count."""
        manifests: list[Path] = []
        strays: list[Path] = []
        with contextlib.suppress(OSError):  # load() reports it
            manifests = tree_files(self.root, self.robot)
            strays = stray_files(self.root)
        return (
            stats(manifests),
            stats(sorted(self._inputs.files)),
            stats([*strays, *below(sorted(self._inputs.mounted)), *self._built_from()]),
        )

    def folders(self) -> list[Path]:
        """Directories to watch: everything that the stamp covers is in one of them. Links that lead out of the tree are
        not followed; image contexts may be outside of it."""
        top, folders = os.path.realpath(self.root), [self.root]
        with contextlib.suppress(OSError):
            folders += sorted(p for p in self.root.iterdir() if p.name[0] != "." and os.path.isdir(p))
        if self.robot:
            folders += manifest_folders(self.root / FOLDER / self.robot)
            folders += sorted({beside(path, self.root) for path in manifest_files(self.root)})
        folders += sorted(path.parent for path in self._inputs.files)
        folders += [p for p in below(sorted(self._inputs.mounted)) if os.path.isdir(p) and not os.path.islink(p)]
        folders += sorted(path.parent for path in self._inputs.mounted)
        contexts = [path for path in self._built_from() if os.path.isdir(path)]
        contexts += [self._git / "logs"] if self._git and os.path.isdir(self._git / "logs") else []
        inside = (
            p for p in dict.fromkeys(folders) if f"{os.path.realpath(p)}/".startswith(f"{top}/") and os.path.isdir(p)
        )
        return list(itertools.islice(itertools.chain(inside, contexts), MOST_FOLDERS))

    def _built_from(self) -> Iterator[Path]:
        return contexts(self._inputs.contexts if self.references and self.references.by_content else ())

    def read(self) -> tuple[bool, bool]:
        """Return (whether there is news, whether to look again soon). A checkout in progress, or a tree that changes
        while it is read, is left for later, but not for ever."""
        if self.source is not None and (self.source.writing or self.source.empty):
            return self._without(self.source), False
        now, stamp, checkout = self.clock(), self.stamp(), self._under_way
        if stamp == self._stamp and not checkout:
            self._since = None
            self.changes.settled(stamp, self.folders())
            return self._moved() or self._built_anew(), False
        waited = 0.0 if self._since is None else now - self._since
        still = self._since is None or stamp[:2] == (self._seen or stamp)[:2]
        if waited < (CHECKOUT if checkout else PATIENCE) and (checkout or not still):
            return self._later(now, stamp)
        if self._stamp and stamp[:2] == self._stamp[:2] and not self.changes.rest(stamp[2], now):
            mounted = {path: f"{self.root.resolve() / path}" for of in self.desired.contents.values() for path in of}
            self.changes.note_unsettled(self._stamp[2], mounted, now)
            return False, True
        moves = head_stamp(self._git)
        before, loaded = self._load(stamp)
        after = self.stamp()
        whole = after[:2] == before[:2] and not (self._under_way and not checkout)
        if not whole and (waited < PATIENCE or (loaded.catalog is None and waited < 2 * PATIENCE)):
            return self._later(now, after)
        self._since, self._stamp, self._moves = None, before, moves
        self._take(loaded)
        self.changes.settled(before, self.folders())
        return True, not whole

    def _without(self, source: GitSource) -> bool:
        """Whether there is news about a repository that has not delivered anything yet."""
        shown, why = source.cache.followed.remote.shown, source.error
        errors = (Diagnostic(Where(shown), f"nothing was fetched yet: {why}"),)
        if source.writing or not why or self.errors == errors:
            return False
        self.errors = errors
        return True

    def _moved(self) -> bool:
        """Whether it is at another commit with the same declarations."""
        before, self._moves = self._moves, head_stamp(self._git)
        return before != self._moves

    def _built_anew(self) -> bool:
        """Whether images that the tree declares are different now, though their sources have not changed."""
        if self.references is None or self._catalog is None or self.references.records.stamp == self._records:
            return False
        stamp = self.references.records.stamp
        try:
            changed = self.references.of(self._catalog) != self.images
        except RorgError:  # a context cannot be read now: the error is reported when it is read with its tree
            return False
        self._records = stamp
        if changed:
            self._take(Loaded(self._catalog, (*self.errors, *self.warnings)))
        return changed

    def read_now(self) -> None:
        """Read it as it is at this moment, even if it is being written."""
        self._moves = head_stamp(self._git)
        self._stamp, loaded = self._load(self.stamp())
        self._take(loaded)
        self.changes.settled(self._stamp, self.folders())

    def _later(self, now: float, seen: Stamp) -> tuple[bool, bool]:
        self._since, self._seen = now if self._since is None else self._since, seen
        return False, True

    def _load(self, stamp: Stamp) -> tuple[Stamp, Loaded]:
        """The tree, with the stamp from before it was read."""
        stamps = [stamp]

        def found(inputs: Inputs) -> None:
            self._inputs = inputs
            stamps.append((stamp[0], *self.stamp()[1:]))

        try:
            loaded = load(self.root, on_inputs=found, engine=self.engine, robot=self.robot)
            loaded = self._seen_from_here(loaded)
        except RorgError as error:
            loaded = Loaded(None, (Diagnostic(Where(str(self.root)), str(error)),))
        return stamps[-1], loaded

    def _seen_from_here(self, loaded: Loaded) -> Loaded:
        here = machine_for(loaded.catalog.machines, self.machine, self.host, self.engine) if loaded.catalog else ""
        if isinstance(here, Diagnostic):
            return replace(loaded, catalog=None, diagnostics=(here,))
        self.here = here if loaded.catalog else self.here
        return replace(loaded, catalog=seen_from(self.adapt(loaded.catalog), here)) if loaded.catalog else loaded

    def _take(self, loaded: Loaded) -> None:
        self.masker.learn(loaded.read)
        loaded, desired, images = self._desired(loaded)
        self.errors = tuple(d for d in loaded.diagnostics if d.severity == "error")
        self.warnings = tuple(d for d in loaded.diagnostics if d.severity == "warning")
        if desired is not None:
            self._catalog = loaded.catalog
            self.desired, self.images, self.loaded = desired, images, True
        elif not self.loaded and (last := self.last()):
            self._begin_with(last)

    def _begin_with(self, last: Catalog) -> None:
        """Begin with a Catalog that an earlier rorg has derived from a good tree."""
        here = machine_for(last.machines, self.machine, self.host, self.engine)
        if not isinstance(here, Diagnostic):
            self.masker.learn(last)
            self.here, self.loaded = here, True
            self.desired = desire_again(last, self._contents.of(last, self.root))

    def _desired(self, loaded: Loaded) -> tuple[Loaded, Desired | None, Content]:
        """What a tree asks for, and from which images; None, with the reason as a diagnostic, if it has errors or if
        rorg has a bug."""
        catalog, images = loaded.catalog, Content()
        if catalog is None:
            return loaded, None, images
        try:
            if self.references:
                self._records, images = self.references.records.stamp, self.references.of(catalog)
            return loaded, desire(catalog, self.run, self._contents.of(catalog, self.root), images.references), images
        except RorgError as error:
            return Loaded(None, (Diagnostic(Where(str(self.root)), str(error)),)), None, images
        except Exception as bug:
            return Loaded(None, (unexpected(Where(str(self.root)), bug),)), None, images
