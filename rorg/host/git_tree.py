"""Extracts the files of a commit into a temporary directory, as a checkout would write them. Files that have not
changed since, as git says, come from the work tree, the others from the repository; files that git does not know are
the current ones. Never writes to the repository."""

from __future__ import annotations

import contextlib
import difflib
import fcntl
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from rorg.errors import Invalid, Unreachable
from rorg.host.git_objects import LINK, MODULE, Entry, contents, entries, read, said, words
from rorg.host.git_process import git_command

LARGE = "/var/tmp"
"""For files that are larger or stay longer than those of /tmp (Filesystem Hierarchy Standard 5.15)."""
EXECUTABLE = "100755"


@dataclass(frozen=True)
class Mirror:
    """The directory `place` stands for `/` of this machine. In it are the files of the repository below `top` as of a
    commit. Files outside of the repository are linked on request."""

    place: Path
    top: Path
    commit: str
    """In full."""

    def at(self, path: Path) -> Path:
        """The place in here of a file of this machine (absolute, without links)."""
        return self.place / path.relative_to("/")

    def real(self, path: Path) -> Path:
        """The file of this machine that one in here stands for."""
        return Path("/") / path.relative_to(self.place) if path.is_relative_to(self.place) else path

    def name(self, text: str) -> str:
        """Replace places in here by those in the commit, as git writes them: abc1234:manifests/a.yaml."""
        return text.replace(f"{self.at(self.top)}/", f"{self.commit[:7]}:").replace(str(self.place), "")

    @cached_property
    def _known(self) -> frozenset[str]:
        """Paths that git knows now, and their directories."""
        paths = words(read(self.top, "ls-files", "-z"))
        return frozenset(paths).union(*({str(p) for p in Path(path).parents} for path in paths))

    def bring(self, paths: Iterable[Path], most_files: int, most_bytes: int) -> None:
        """Bring files and directories of this machine that git does not know, as they are now: those in the repository
        are copied, others linked. If they are too many or too large, the first one beyond the limit is the last, and
        comes without content, so that a caller who counts them finds too many as well. Unreadable files are left out,
        and everything that is not a file, link or directory. Raises OSError."""
        files, size = 0, 0
        for path in paths:
            target = self.at(path)
            around = target.parent
            if os.path.lexists(target) or not os.path.lexists(path) or os.path.realpath(around) != str(around):
                continue
            with contextlib.suppress(PermissionError, FileNotFoundError):
                if not path.is_relative_to(self.top):
                    _parents(target)
                    target.symlink_to(path)
                elif str(path.relative_to(self.top)) not in self._known:
                    files, size = files + 1, size + path.lstat().st_size
                    if files > most_files or size > most_bytes:
                        _hollow(path, target)
                        return
                    self._copy(path)

    def _copy(self, path: Path) -> None:
        """Copy it, with the directories above it."""
        target = self.at(path)
        if not target.parent.exists():
            self._copy(path.parent)
        if path.is_dir() and not path.is_symlink():
            target.mkdir()
            shutil.copystat(path, target)
        elif path.is_symlink() or path.is_file():
            shutil.copy2(path, target, follow_symlinks=False)

    def fill(self) -> None:
        """Write the commit's files in here."""
        tree_entries = entries(read(self.top, "ls-tree", "-r", "-z", "--full-tree", self.commit))
        differing = ("diff", "--name-only", "--no-renames", "--no-ext-diff", "--ignore-submodules", "-z")
        changed = set(words(read(self.top, *differing, self.commit, "--")))
        fetched = []
        for entry in tree_entries:
            path = self.top / entry.path
            if entry.mode == MODULE:
                continue
            if entry.path in changed or not os.access(path, os.R_OK):
                fetched.append(entry)
            else:
                self._copy(path)
        for entry, content in contents(self.top, fetched):
            self._write(entry, content)

    def _write(self, entry: Entry, content: bytes) -> None:
        """Write a file that has changed since. Its permissions are those of the current file, otherwise of its
        directory."""
        path, target = self.top / entry.path, self.at(self.top / entry.path)
        self._directory(path.parent)
        if entry.mode == LINK:
            os.symlink(content, bytes(target))
            return
        target.write_bytes(content)
        allowed = _mode(path, stat.S_ISREG)
        if allowed is None or bool(allowed & stat.S_IXUSR) != (entry.mode == EXECUTABLE):
            around = stat.S_IMODE(target.parent.stat().st_mode)
            allowed = around & (0o777 if entry.mode == EXECUTABLE else 0o666)
        target.chmod(allowed)

    def _directory(self, path: Path) -> None:
        """Permissions are those of the current directory, otherwise of the one above."""
        target = self.at(path)
        if target.is_dir():
            return
        self._directory(path.parent)
        target.mkdir()
        allowed = _mode(path, stat.S_ISDIR)
        target.chmod(stat.S_IMODE(target.parent.stat().st_mode) if allowed is None else allowed)


@contextlib.contextmanager
def extracted(root: Path, commit: str) -> Iterator[Mirror]:
    """The files of a directory's repository as of a commit (from resolved()), until the end of the block. Raises
    Invalid and Unreachable."""
    top = said(root, "rev-parse", "--show-toplevel")
    with temporary_folder("rorg-past-", _large()) as place:
        mirror = Mirror(Path(os.path.realpath(place)), Path(top), commit)
        try:
            _parents(mirror.at(mirror.top))
            mirror.at(mirror.top).mkdir()
            shutil.copystat(mirror.top, mirror.at(mirror.top))
            mirror.fill()
        except (OSError, ValueError) as error:
            raise Unreachable(f"read {commit[:7]} of {top}", str(error)) from error
        yield mirror


def _large() -> str:
    """A directory for large temporary files: /tmp is often in memory."""
    return LARGE if os.access(LARGE, os.W_OK) and "TMPDIR" not in os.environ else tempfile.gettempdir()


def resolved(root: Path, text: str) -> str:
    """The full hash that git understands by a text in the repository of a directory: a commit, a tag, a branch, HEAD~2.
    Raises Invalid."""
    what = f"read the manifests of '{text}'"
    if not said(root, "rev-parse", "--show-toplevel"):
        why = f"{root} is in no git repository that this user may read"
        init, status = (git_command(root, word) for word in ("init", "status"))
        raise Invalid(what, why, f"`{init}` and a commit, or `{status}` for the reason")
    # An option is no commit, and must not reach git.
    odd = text.startswith("-") or "\0" in text
    commit = "" if odd else said(root, "rev-parse", "--verify", "--quiet", f"{text}^{{commit}}")
    if not commit:
        names = said(root, "for-each-ref", "--format=%(refname:short)").splitlines()
        near = difflib.get_close_matches(text, names, 1)
        remedy = f"'{near[0]}'" if near else f"`{git_command(root, 'log')}`"
        raise Invalid(what, "git knows no such commit, tag or branch", remedy)
    return commit


# -- files -----------------------------------------------------------------------------------------------------


def _parents(target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)


def _mode(path: Path, form: Callable[[int], bool]) -> int | None:
    """The permissions; None if there is nothing of that form."""
    try:
        facts = path.lstat()
    except OSError:
        return None
    return stat.S_IMODE(facts.st_mode) if form(facts.st_mode) else None


def _hollow(path: Path, target: Path) -> None:
    """A file of the same size without content."""
    _parents(target)
    with open(target, "wb") as file:
        file.truncate(path.lstat().st_size)
    shutil.copymode(path, target)


@contextlib.contextmanager
def temporary_folder(prefix: str, within: str) -> Iterator[Path]:
    """A directory until the end of the block. Directories of the same prefix whose process has died are removed first.
    Each process locks its own, so that a live one is recognized in every PID namespace."""
    _remove_dead(prefix, Path(within))
    place, descriptor = _made(prefix, within)
    try:
        yield place
    finally:
        _remove(place)
        os.close(descriptor)


def _made(prefix: str, within: str) -> tuple[Path, int]:
    while True:
        place = Path(tempfile.mkdtemp(prefix=prefix, dir=within))
        # Until it is locked, another process may take it for one of a dead process.
        with contextlib.suppress(FileNotFoundError):
            descriptor = _opened(place)
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            if place.is_dir():
                return place, descriptor
            os.close(descriptor)


def _remove_dead(prefix: str, within: Path) -> None:
    for place in within.glob(f"{prefix}*"):
        with contextlib.suppress(OSError):  # another user's, or gone by now
            descriptor = _opened(place)
            try:
                if os.fstat(descriptor).st_uid == os.geteuid():
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    _remove(place)
            finally:
                os.close(descriptor)


def _remove(place: Path) -> None:
    def again(function: Callable[[str], object], path: str, _: object) -> None:
        """For files in a directory without write permission."""
        with contextlib.suppress(OSError):
            os.chmod(os.path.dirname(path), 0o700)
            function(path)

    shutil.rmtree(place, onerror=again)


def _opened(place: Path) -> int:
    return os.open(place, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
