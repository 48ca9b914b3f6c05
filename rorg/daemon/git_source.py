"""Follows a repository for the loop: fetches in a thread of its own, and puts acceptable commits into force."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from queue import Queue
from typing import Any

from rorg.daemon.wakes import Wakes
from rorg.host.git import head
from rorg.host.git_cache import GitCache, Unacceptable, Unreachable

MOST_FOLDERS = 100
"""Directories of a local repository's references that are watched."""


class GitSource:
    """`poll`: seconds between two fetches; `wall` gives ISO 8601 in UTC. While `writing` is set the tree must not be
    read."""

    def __init__(self, cache: GitCache, poll: float, wall: Callable[[], str]) -> None:
        self.cache, self.poll, self.wall = cache, poll, wall
        self.wakes = Wakes()
        """Those of the loop. Woken when the tree, or what is reported of it, may have changed."""
        self.events: Queue[tuple[str, object, str, str]] = Queue()
        """For the reporter: (key, value, kind of event, message), as Recorder.when_new() takes them."""
        self.writing = self.empty = True
        self._accepted = ""
        self.commit = self.fetched_at = self.error = self._news = ""
        self._asked = threading.Event()
        self._turn = threading.Condition()
        self._begun = self._ended = 0
        """Numbers of fetches."""

    @property
    def root(self) -> Path:
        """The directory of the manifests."""
        return self.cache.tree / self.cache.followed.path

    def as_json(self) -> dict[str, Any]:
        return {
            "followed": True,
            "repository": self.cache.followed.remote.shown,
            "branch": self.cache.followed.remote.branch,
            "commit": self.commit,
            "fetched_at": self.fetched_at,
            "error": self.error,
        }

    # -- what the loop's other threads call ------------------------------------------------------------------------

    def start(self) -> None:
        """Put what was fetched earlier into force immediately, even if nothing can be fetched now."""
        self._guarded(self._prepare)
        threading.Thread(target=self._run, name="git", daemon=True).start()

    def stop(self) -> None:
        self.cache.stop.set()
        self.ask()

    def ask(self) -> None:
        """Fetch soon."""
        self._asked.set()

    def fetch(self, patience: float) -> bool:
        """Fetch, and wait up to so many seconds; return whether the fetch has ended."""
        with self._turn:
            wanted = self._begun + 1
            self.ask()
            return self._turn.wait_for(lambda: self._ended >= wanted, patience)

    def folders(self) -> list[Path]:
        """Directories in which a local repository writes what its branches are at. The first may be missing."""
        git = self.cache.followed.remote.git
        if git is None:
            return []
        folders = (Path(folder) for folder, _, _ in os.walk(git / "refs/heads"))
        return [git, *(folder for _, folder in zip(range(MOST_FOLDERS), folders, strict=False))]

    def ignores(self, path: str) -> bool:
        """Whether a file in there says nothing about that."""
        return path.endswith(".lock") or not ("/refs/" in path or path.endswith(("/HEAD", "/packed-refs")))

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self.cache.stop.is_set():
            with self._turn:
                self._asked.clear()
                self._begun += 1
            self._guarded(self._sync)
            with self._turn:
                self._ended = self._begun
                self._turn.notify_all()
            self._asked.wait(self.poll)

    def _guarded(self, work: Callable[[], None]) -> None:
        """Report what goes wrong; the next turn comes in any case."""
        kind, error = "git", ""
        try:
            work()
        except Unacceptable as refused:
            kind, error = "git-refused", f"{refused}"
        except Unreachable as why:
            kind, error = "git-unreachable", f"{why}"
        except OSError as why:
            kind, error = "git-unreachable", f"{why.filename or self.cache.folder}: {why.strerror or why}"
        except Exception as bug:
            kind, error = "internal-error", f"internal error: {type(bug).__name__}: {bug}"
        if self.cache.stop.is_set():
            return
        changed, self.error = self.error != error, error
        shown = self.cache.followed.remote.shown
        kept = f"{self.commit[:10]} stays in force" if self.commit else "nothing new is in force"
        if changed:
            text = f"git: {shown}: {error}; {kept}" if error else f"git: {shown} is followed again"
            self.events.put(("git", error, kind, text))
            self.wakes.files_changed()

    def _prepare(self) -> None:
        self.cache.prepare()
        self._in_force()

    def _in_force(self) -> None:
        self.commit, self.empty, self.writing = self.cache.commit, self.cache.empty, False
        self.wakes.files_changed()

    def _sync(self) -> None:
        if self.writing:
            self._prepare()
        commit = self.cache.fetch()
        self.fetched_at = self.wall()
        if commit != self._accepted:
            self.cache.check(commit)
        if commit != self.commit:
            self._advance(commit)
            self.cache.tidy()
        self._accepted = commit

    def take_news(self) -> str:
        """The new commit since the last call, for people; empty if there is none. Whether it comes into force is known
        only after its manifests are read."""
        news, self._news = self._news, ""
        return news

    def _advance(self, commit: str) -> None:
        self.writing = True
        self.cache.advance(commit)
        tip = head(self.cache.tree)
        self._news = f"git: {commit[:10]}" + (f": {tip.subject} ({tip.author})" if tip else "")
        self._in_force()
        if left := self.cache.submodules():
            text = f"git: submodules are not followed, their directories are empty: {', '.join(left)}"
            self.events.put(("git-submodules", left, "git-submodules", text))
            self.wakes.wake()
