"""Counts what a running rorg does to the world, and kills it at one of these effects.

An effect is a change of a file in the state directory or the tree, a commit of the journal, a call that changes
something in the engine, a git command that changes something, or an answer to a client that changed something. A point
is the number of an effect and a side: `before`, `after`, or `power`, which also loses what no fsync has secured. The
sides `power-0`, `power-1` and so on lose it in other ways: see disk.py.
"""

from __future__ import annotations

import builtins
import contextlib
import io
import os
import signal
import sqlite3
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from proof.disk import Disk

SIDES = ("before", "after", "power")
ORDERED = "power-"
"""Before the number of an outcome."""
GIT_READS = ("rev-parse", "cat-file", "log", "show", "status", "ls-files", "ls-tree", "diff", "for-each-ref", "config")
GIT_READS += ("check-ignore", "version", "--version", "symbolic-ref", "show-ref", "ls-remote", "merge-base", "var")
"""Commands of git that change nothing."""
PATIENCE = 0.5
"""Seconds for effects of other threads."""
COMMITS = ("COMMIT", "PRAGMA wal_checkpoint")


class Effects:
    """Counts the effects below `roots`; kills this process at number `point` on a `side`. `trace` gets a line each, and
    without a point the file beside it how many outcomes a loss of power has after each."""

    def __init__(self, roots: tuple[str, ...], point: int, side: str, trace: str) -> None:
        self.roots, self.point, self.side = tuple(os.path.realpath(r) + "/" for r in roots), point, side
        self.number, self.disk = 0, Disk()
        self._lock = threading.RLock()
        self._under_way: set[int] = set()
        """Effects of which other threads are in the middle."""
        self._trace = os.open(trace, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC)
        self._outcomes = -1 if point else os.open(f"{trace}.outcomes", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._write = os.write

    @contextlib.contextmanager
    def effect(self, what: str) -> Iterator[None]:
        """Around everything that counts."""
        with self._lock:
            self.number += 1
            number, mine = self.number, self.number == self.point
            self._write(self._trace, f"{self.number} {what}\n".encode())
            if mine and self.side == "before":
                self._die()
            self._under_way.add(number)
        try:
            yield
        finally:
            self._under_way.discard(number)
        with self._lock:
            if self._outcomes >= 0:
                self._write(self._outcomes, f"{number} {len(self.disk.outcomes(number))}\n".encode())
            if mine:
                self._die()

    def _die(self) -> None:
        """Nobody begins an effect meanwhile; a loss of power waits for those that are under way."""
        until = time.monotonic() + PATIENCE
        while self.side.startswith("power") and self._under_way and time.monotonic() < until:
            time.sleep(0.001)
        if self.side == "power":
            self.disk.lose()
        elif self.side.startswith(ORDERED):
            outcomes = self.disk.outcomes(self.point)
            if outcomes:
                self.disk.leave(outcomes[int(self.side.removeprefix(ORDERED)) % len(outcomes)])
        os.kill(os.getpid(), signal.SIGKILL)
        signal.pause()

    def ours(self, path: object, dir_fd: int | None = None) -> str:
        """The real path, if it is in one of the roots and not the journal's; else empty."""
        if isinstance(path, int):
            path = os.readlink(f"/proc/self/fd/{path}")
        text = os.fsdecode(path)  # type: ignore[arg-type]
        if dir_fd is not None and not text.startswith("/"):
            text = os.path.join(os.readlink(f"/proc/self/fd/{dir_fd}"), text)
        folder, name = os.path.split(os.path.abspath(text))
        text = os.path.join(os.path.realpath(folder), name)
        return text if f"{text}/".startswith(self.roots) and "journal.db" not in name else ""

    # -- what is counted -----------------------------------------------------------------------------------------

    def install(self) -> None:
        """Count in this process from now on."""
        self._names()
        self._contents()
        self._journal()
        self._git()
        self._answers()

    def _names(self) -> None:
        """Changes of directories."""
        for verb in ("unlink", "remove", "rmdir", "mkdir"):
            setattr(os, verb, self._of_one(verb, getattr(os, verb)))
        for verb in ("rename", "replace", "link", "symlink"):
            setattr(os, verb, self._of_two(verb, getattr(os, verb)))

    def _of_one(self, verb: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(path: Any, *args: Any, **more: Any) -> Any:
            place = self.ours(path, more.get("dir_fd"))
            if not place or (verb in ("unlink", "remove") and not os.path.lexists(place)):
                return real(path, *args, **more)
            with self.effect(f"{verb} {place}"):
                self.disk.keep(place)
                done = real(path, *args, **more)
                (self.disk.made if verb == "mkdir" else self.disk.removed)(place)
                return done

        return call

    def _of_two(self, verb: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(source: Any, target: Any, **more: Any) -> Any:
            old, new = self.ours(source), self.ours(target)
            if not new:
                return real(source, target, **more)
            with self.effect(f"{verb} {new}"):
                self.disk.keep(*filter(None, (old, new)))
                done = real(source, target, **more)
                if verb in ("rename", "replace") and old:
                    self.disk.renamed(old, new)
                return done

        return call

    def _contents(self) -> None:
        real_open, real_fdopen, real_fsync = os.open, os.fdopen, os.fsync

        def open_(path: Any, flags: int, *args: Any, **more: Any) -> int:
            place = self.ours(path, more.get("dir_fd")) if flags & os.O_CREAT else ""
            if not place or os.path.exists(place):
                return real_open(path, flags, *args, **more)
            with self.effect(f"create {place}"):
                self.disk.keep(place)
                descriptor = real_open(path, flags, *args, **more)
                self.disk.created(place)
                return descriptor

        def fdopen(descriptor: int, mode: str = "r", *args: Any, **more: Any) -> Any:
            file = real_fdopen(descriptor, mode, *args, **more)
            place = self.ours(descriptor) if set(mode) & set("wa+") else ""
            return Written(self, place, file) if place else file

        def fsync(descriptor: Any) -> None:
            place = self.ours(descriptor if isinstance(descriptor, int) else descriptor.fileno())
            if not place:
                return real_fsync(descriptor)
            with self.effect(f"fsync {place}"):
                real_fsync(descriptor)
                self.disk.synced(place)

        os.open, os.fdopen, os.fsync, os.fdatasync = open_, fdopen, fsync, fsync  # type: ignore[assignment]
        self._files(io.open)

    def _files(self, real: Callable[..., Any]) -> None:
        """Files that are written in their place."""

        def opened(path: Any, mode: str = "r", *args: Any, **more: Any) -> Any:
            place = self.ours(path) if set(mode) & set("wxa+") and not isinstance(path, int) else ""
            if not place:
                return real(path, mode, *args, **more)
            with self.effect(f"open {place}"):
                self.disk.keep(place)
                new = not os.path.exists(place)
                file = real(path, mode, *args, **more)
                (self.disk.created if new else self.disk.wrote)(place)
                return Written(self, place, file)

        io.open = builtins.open = opened  # type: ignore[assignment]

    def _journal(self) -> None:
        effects, real = self, sqlite3.connect

        class Counted(sqlite3.Connection):
            def execute(self, sql: str, *args: Any) -> sqlite3.Cursor:
                if not sql.startswith(COMMITS):
                    return super().execute(sql, *args)
                with effects.effect(f"sqlite {sql}"):
                    return super().execute(sql, *args)

            def executescript(self, sql: str) -> sqlite3.Cursor:
                with effects.effect("sqlite script"):
                    return super().executescript(sql)

        sqlite3.connect = lambda *args, **more: real(*args, **{"factory": Counted, **more})  # type: ignore[assignment]

    def _git(self) -> None:
        effects, real = self, subprocess.Popen

        class Counted(real):  # type: ignore[misc, valid-type]
            def __init__(self, args: Any, *more: Any, **options: Any) -> None:
                self.effect = effects.effect(shown) if (shown := changing(args)) else contextlib.nullcontext()
                self.effect.__enter__()
                super().__init__(args, *more, **options)

            def _handle_exitstatus(self, *args: Any, **more: Any) -> None:
                super()._handle_exitstatus(*args, **more)
                effect, self.effect = self.effect, contextlib.nullcontext()
                effect.__exit__(None, None, None)

        subprocess.Popen = Counted  # type: ignore[misc]

    def _answers(self) -> None:
        from rorg.api.forwarding import Forwarded

        effects, real = self, Forwarded.__call__

        async def call(app: Any, scope: Any, receive: Any, send: Any) -> None:
            if scope["type"] != "http" or scope["method"] == "GET":
                return await real(app, scope, receive, send)
            with effects.effect(f"asked {scope['method']} {scope['path']}"):
                pass

            async def answer(message: Any) -> None:
                if message["type"] != "http.response.start":
                    return await send(message)
                with effects.effect(f"answer {scope['method']} {scope['path']}: {message['status']}"):
                    await send(message)

            await real(app, scope, receive, answer)

        Forwarded.__call__ = call  # type: ignore[method-assign]


class Written:
    """A file whose content counts as written when it is flushed or closed."""

    def __init__(self, effects: Effects, place: str, file: io.IOBase) -> None:
        self._effects, self._place, self._file, self._pending = effects, place, file, False

    def write(self, content: Any) -> Any:
        self._pending = True
        return self._file.write(content)  # type: ignore[attr-defined]

    def flush(self) -> None:
        if self._pending:
            self._pending = False
            with self._effects.effect(f"write {self._place}"):
                self._file.flush()
                self._effects.disk.wrote(self._place)

    def close(self) -> None:
        self.flush()
        self._file.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __enter__(self) -> Written:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def changing(args: Any) -> str:
    """A command of git that changes something, for people; empty for anything else."""
    words = [os.fsdecode(a) for a in args] if isinstance(args, list | tuple) else []
    if not words or os.path.basename(words[0]) != "git":
        return ""
    rest = iter(words[1:])
    for word in rest:
        if word in ("-C", "-c", "--git-dir", "--work-tree"):
            next(rest, None)
        elif not word.startswith("-"):
            return "" if word in GIT_READS else f"git {word}"
    return ""
