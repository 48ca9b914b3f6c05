"""A repository that a robot follows, and its git."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from robots import write_tree


def git(folder: Path, *words: str, **more) -> str:
    who = ("-c", "user.name=Anna", "-c", "user.email=anna@example.org", "-c", "init.defaultBranch=main")
    done = subprocess.run(
        ["git", *who, "-C", str(folder), *words],
        text=True,
        stdout=subprocess.PIPE,
        env={"PATH": os.environ["PATH"], "HOME": "/nowhere"},
        **more,
    )
    assert done.returncode == 0, words
    return done.stdout.strip()


class Origin:
    """A bare repository, and the clone of somebody who pushes to it."""

    def __init__(self, folder: Path) -> None:
        self.bare, self.clone = folder / "origin.git", folder / "clone"
        folder.mkdir(exist_ok=True)
        git(folder, "init", "--quiet", "--bare", str(self.bare))
        write_tree(self.clone, {"camera": {}})
        git(self.clone, "init", "--quiet")
        git(self.clone, "remote", "add", "origin", str(self.bare))

    def push(self, message: str, files: dict[str, str] | None = None, *words: str, amend: bool = False) -> str:
        for name, text in (files or {}).items():
            (self.clone / name).parent.mkdir(parents=True, exist_ok=True)
            (self.clone / name).write_text(text)
        git(self.clone, "add", "--all")
        git(self.clone, *words, "commit", "--quiet", "--allow-empty", "-m", message, *(["--amend"] if amend else []))
        git(self.clone, "push", "--quiet", "--force", "origin", "HEAD:refs/heads/main")
        return git(self.clone, "rev-parse", "HEAD")
