"""A state of a repository's files from its history, in a temporary directory, as a checkout would give it: what has not
changed since, as git says, is taken from the work tree, the rest from the repository, and what git does not know stays
as it is. Nothing is written to the repository."""

from __future__ import annotations

import contextlib
import difflib
import os
import shutil
import signal
import stat
import subprocess
import tempfile
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import compress
from operator import not_
from pathlib import Path
from typing import IO, NamedTuple

from rorg.errors import Invalid, Unreachable
from rorg.host.commands import end
from rorg.host.git_process import begin_git, owner_of, repository

PATIENCE = 60.0
"""Seconds for one question to git: it may be about all files."""
LARGE = "/var/tmp"
"""For files that are larger or stay longer than those of /tmp (Filesystem Hierarchy Standard 5.15)."""
LINK, MODULE = "120000", "160000"
"""Modes of git: a symbolic link, and the place of another repository."""
EXECUTABLE = "100755"


class Entry(NamedTuple):
    """A file of a commit."""

    mode: str
    object: str
    path: str


@dataclass(frozen=True)
class Mirror:
    """The directory `place` stands for `/` of this machine, and in it lie the files of the repository below `top` as
    they were in a commit. What lies beside the repository is linked where it is asked for."""

    place: Path
    top: Path
    commit: str
    """In full."""

    def at(self, path: Path) -> Path:
        """Where a file of this machine (absolute, without links) lies in here."""
        return self.place / path.relative_to("/")

    def real(self, path: Path) -> Path:
        """The file of this machine that one in here stands for."""
        return Path("/") / path.relative_to(self.place) if path.is_relative_to(self.place) else path

    def name(self, text: str) -> str:
        """A text in which places of here are those of the commit, as git writes them: abc1234:manifests/a.yaml."""
        return text.replace(f"{self.at(self.top)}/", f"{self.commit[:7]}:").replace(str(self.place), "")

    @cached_property
    def _known(self) -> frozenset[str]:
        """Paths that git knows now, and their directories."""
        found = _words(_read(self.top, "ls-files", "-z"))
        return frozenset(found).union(*({str(p) for p in Path(path).parents} for path in found))

    def bring(self, paths: Iterable[Path], most_files: int, most_bytes: int) -> None:
        """Puts files and directories of this machine in here that git does not know, as they are now: those of the
        repository are copied, others are linked. The one with which they are too many or too large comes without its
        content, and is the last: whoever counts them finds them too large too. What cannot be read is left out, and so
        is what is no file, link or directory. Raises OSError."""
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
        """With the directories above it, as they are."""
        target = self.at(path)
        if not target.parent.exists():
            self._copy(path.parent)
        if path.is_dir() and not path.is_symlink():
            target.mkdir()
            shutil.copystat(path, target)
        elif path.is_symlink() or path.is_file():
            shutil.copy2(path, target, follow_symlinks=False)

    def fill(self) -> None:
        """Puts the commit's files in here."""
        entries = _entries(_read(self.top, "ls-tree", "-r", "-z", "--full-tree", self.commit))
        differing = ("diff", "--name-only", "--no-renames", "--no-ext-diff", "--ignore-submodules", "-z")
        changed = set(_words(_read(self.top, *differing, self.commit, "--")))
        fetched = []
        for entry in entries:
            path = self.top / entry.path
            if entry.mode == MODULE:
                continue
            if entry.path in changed or not os.access(path, os.R_OK):
                fetched.append(entry)
            else:
                self._copy(path)
        for entry, content in _contents(self.top, fetched):
            self._write(entry, content)

    def _write(self, entry: Entry, content: bytes) -> None:
        """A file that is another one now. Who may read it is as of the file there now, else as of its directory."""
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
        """One that is there now is as it is now, others are as the one above."""
        target = self.at(path)
        if target.is_dir():
            return
        self._directory(path.parent)
        target.mkdir()
        allowed = _mode(path, stat.S_ISDIR)
        target.chmod(stat.S_IMODE(target.parent.stat().st_mode) if allowed is None else allowed)


@contextlib.contextmanager
def extracted(root: Path, commit: str) -> Iterator[Mirror]:
    """The files of the repository that a directory lies in, as of a commit (from resolved()), until the end of the
    block. Raises Invalid and Unreachable."""
    top = _said(root, "rev-parse", "--show-toplevel")
    with tempfile.TemporaryDirectory(prefix="rorg-past-", dir=_large(), ignore_cleanup_errors=True) as place:
        mirror = Mirror(Path(os.path.realpath(place)), Path(top), commit)
        try:
            _parents(mirror.at(mirror.top))
            mirror.at(mirror.top).mkdir()
            shutil.copystat(mirror.top, mirror.at(mirror.top))
            mirror.fill()
        except (OSError, ValueError) as error:
            raise Unreachable(f"read {commit[:7]} of {top}", str(error)) from error
        yield mirror


def _large() -> str | None:
    """Where much may be written for a while: /tmp is often in memory."""
    return LARGE if os.access(LARGE, os.W_OK) and "TMPDIR" not in os.environ else None


def resolved(root: Path, text: str) -> str:
    """The commit, in full, that git understands by a text in the repository of a directory: a commit, tag, branch or
    the like of HEAD~2. Raises Invalid."""
    what = f"read the manifests of '{text}'"
    if not _said(root, "rev-parse", "--show-toplevel"):
        why = f"{root} is in no git repository that this user may read"
        raise Invalid(what, why, f"`git init {root}` and a commit, or `git -C {root} status` for the reason")
    # An option of git is no commit, and nothing that it may be asked.
    odd = text.startswith("-") or "\0" in text
    found = "" if odd else _said(root, "rev-parse", "--verify", "--quiet", f"{text}^{{commit}}")
    if not found:
        names = _said(root, "for-each-ref", "--format=%(refname:short)").splitlines()
        near = difflib.get_close_matches(text, names, 1)
        raise Invalid(what, "git knows no such commit, tag or branch", f"'{near[0]}'" if near else "`git log`")
    return found


# -- what git says ---------------------------------------------------------------------------------------------


def _said(directory: Path, *args: str) -> str:
    """One word of it; empty where it says no."""
    try:
        return _read(directory, *args).decode(errors="surrogateescape").rstrip("\n")
    except Unreachable:
        return ""


def _read(directory: Path, *args: str, stdin: int | IO[bytes] = subprocess.DEVNULL) -> bytes:
    """All that it prints. Raises Unreachable where it says no, or nothing in time."""
    with _asked(directory, args, stdin) as file:
        return file.read()


@contextlib.contextmanager
def _asked(directory: Path, args: Sequence[str], stdin: int | IO[bytes]) -> Iterator[IO[bytes]]:
    """A file with all that it prints."""
    what = f"ask git in {directory}"
    found = repository(directory)
    owner = owner_of(found) if found else None
    with tempfile.TemporaryFile() as file:
        try:
            process = begin_git(["-C", str(directory), *args], owner, stdin=stdin, stdout=file)
        except OSError as error:
            raise Unreachable(what, f"git: {error.strerror}", "installing git") from error
        try:
            code = process.wait(PATIENCE)
        except subprocess.TimeoutExpired as error:
            end(process, signal.SIGTERM)
            raise Unreachable(what, f"no answer to `git {args[0]}` within {PATIENCE:g} s") from error
        if code:
            raise Unreachable(what, f"`git {' '.join(args)}` fails", f"it in {directory}")
        file.seek(0)
        yield file


def _words(output: bytes) -> list[str]:
    return [os.fsdecode(word) for word in output.split(b"\0") if word]


def _entries(output: bytes) -> list[Entry]:
    """Of `git ls-tree -z`: MODE TYPE OBJECT, a tabulator, PATH. Raises ValueError for what no checkout has: a path that
    leads elsewhere, or that a link may lead elsewhere."""
    found = []
    for line in _words(output):
        about, _, path = line.partition("\t")
        mode, _, name = about.split(" ")
        if path.startswith("/") or {".", "..", ".git", ""} & set(path.split("/")):
            raise ValueError(f"the commit has a file '{path}'")
        found.append(Entry(mode, name, path))
    files = {entry.path for entry in found}
    if twice := next((e.path for e in found if not files.isdisjoint(map(str, Path(e.path).parents))), ""):
        raise ValueError(f"the commit has '{twice}' below what is a file too")
    return found


def _contents(top: Path, entries: Sequence[Entry]) -> Iterator[tuple[Entry, bytes]]:
    """What files have in them, as they would be checked out. Paths with a line's end are read as they are kept."""
    plain = [entry.mode != LINK and "\n" not in entry.path for entry in entries]
    filtered, others = list(compress(entries, plain)), list(compress(entries, map(not_, plain)))
    yield from zip(filtered, _batch(top, ["--filters"], [f"{e.object} {e.path}\n" for e in filtered]), strict=True)
    yield from zip(others, _batch(top, [], [f"{e.object}\n" for e in others]), strict=True)


def _batch(top: Path, args: list[str], lines: list[str]) -> Iterator[bytes]:
    """Of `git cat-file --batch`: OBJECT TYPE SIZE, a line's end, the content, a line's end. SIZE is as before filters,
    so that after each object one is asked for that nobody has: the answer to that is the end."""
    if not lines:
        return
    nobody = uuid.uuid4().hex
    mark = f"{nobody} missing\n".encode()
    with tempfile.TemporaryFile() as asked:
        asked.write(os.fsencode("".join(f"{line}{nobody}{' -' * len(args)}\n" for line in lines)))
        asked.seek(0)
        with _asked(top, ["cat-file", "--batch", *args], asked) as file:
            for _ in lines:
                file.readline()
                yield from _until(mark, file)


def _until(mark: bytes, file: IO[bytes]) -> Iterator[bytes]:
    """All before the line's end before a mark, which are read too."""
    found = []
    while (line := file.readline()) != mark:
        if not line:
            raise ValueError("git ends amid a file")
        found.append(line)
    yield b"".join(found).removesuffix(b"\n")


# -- files -----------------------------------------------------------------------------------------------------


def _parents(target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)


def _mode(path: Path, form: Callable[[int], bool]) -> int | None:
    """Who may do what with it; None where there is nothing of that form."""
    try:
        facts = path.lstat()
    except OSError:
        return None
    return stat.S_IMODE(facts.st_mode) if form(facts.st_mode) else None


def _hollow(path: Path, target: Path) -> None:
    """A file of the same size, with nothing in it."""
    _parents(target)
    with open(target, "wb") as file:
        file.truncate(path.lstat().st_size)
    shutil.copymode(path, target)
