"""Reads commits, their entries and files from a repository, as its owner; never writes."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import uuid
from collections.abc import Iterator, Sequence
from itertools import compress
from operator import not_
from pathlib import Path
from typing import IO, NamedTuple

from rorg.errors import TimedOut, Unreachable
from rorg.host.commands import end
from rorg.host.git_process import begin_git, git_command, owner_of, repository

PATIENCE = 60.0
"""Seconds for one question to git: it may be about all files."""
LINK, MODULE = "120000", "160000"
"""Modes in git: a symbolic link, and the place of a submodule."""


class Entry(NamedTuple):
    """A file of a commit."""

    mode: str
    object: str
    path: str


def said(directory: Path, *args: str) -> str:
    """Output of a single line; empty if git refuses. Raises TimedOut: no answer is no refusal."""
    try:
        return read(directory, *args).decode(errors="surrogateescape").rstrip("\n")
    except TimedOut:
        raise
    except Unreachable:
        return ""


def read(directory: Path, *args: str, stdin: int | IO[bytes] = subprocess.DEVNULL) -> bytes:
    """The whole output. Raises Unreachable if git refuses, and TimedOut if it does not answer in time."""
    with _asked(directory, args, stdin) as file:
        return file.read()


@contextlib.contextmanager
def _asked(directory: Path, args: Sequence[str], stdin: int | IO[bytes]) -> Iterator[IO[bytes]]:
    """The whole output in a file."""
    what = f"ask git in {directory}"
    git_path = repository(directory)
    owner = owner_of(git_path) if git_path else None
    with tempfile.TemporaryFile() as file:
        try:
            process = begin_git(["-C", str(directory), *args], owner, stdin=stdin, stdout=file)
        except OSError as error:
            raise Unreachable(what, f"git: {error.strerror}", "to install git") from error
        try:
            code = process.wait(PATIENCE)
        except subprocess.TimeoutExpired as error:
            end(process, signal.SIGTERM)
            raise TimedOut(what, f"no answer to `git {args[0]}` within {PATIENCE:g} s", "again") from error
        if code:
            raise Unreachable(what, f"`git {' '.join(args)}` fails", f"`{git_command(directory, *args)}`")
        file.seek(0)
        yield file


def words(output: bytes) -> list[str]:
    """The words in an output of `-z`."""
    return [os.fsdecode(word) for word in output.split(b"\0") if word]


def entries(output: bytes) -> list[Entry]:
    """The entries in an output of `git ls-tree -z`: MODE TYPE OBJECT, a tab, PATH. Raises ValueError for what no
    checkout has: a path that leads out, or that could lead out through a link."""
    tree_entries = []
    for line in words(output):
        about, _, path = line.partition("\t")
        mode, _, name = about.split(" ")
        if path.startswith("/") or {".", "..", ".git", ""} & set(path.split("/")):
            raise ValueError(f"the commit has a file '{path}'")
        tree_entries.append(Entry(mode, name, path))
    files = {entry.path for entry in tree_entries}
    if twice := next((e.path for e in tree_entries if not files.isdisjoint(map(str, Path(e.path).parents))), ""):
        raise ValueError(f"the commit has '{twice}' below a path that is also a file")
    return tree_entries


def contents(top: Path, entries: Sequence[Entry]) -> Iterator[tuple[Entry, bytes]]:
    """The content of files, as a checkout would write it. Files with a newline in their path are read as they are
    stored."""
    plain = [entry.mode != LINK and "\n" not in entry.path for entry in entries]
    filtered, others = list(compress(entries, plain)), list(compress(entries, map(not_, plain)))
    yield from zip(filtered, _batch(top, ["--filters"], [f"{e.object} {e.path}\n" for e in filtered]), strict=True)
    yield from zip(others, _batch(top, [], [f"{e.object}\n" for e in others]), strict=True)


def _batch(top: Path, args: list[str], lines: list[str]) -> Iterator[bytes]:
    """Read `git cat-file --batch`: OBJECT TYPE SIZE, a newline, the content, a newline. SIZE is the size before
    filters, so rorg asks for a nonexistent object after each one, and takes the answer to that as the end."""
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
    """Everything up to the newline before a mark; reads the mark too."""
    lines = []
    while (line := file.readline()) != mark:
        if not line:
            raise ValueError("git ends amid a file")
        lines.append(line)
    yield b"".join(lines).removesuffix(b"\n")
