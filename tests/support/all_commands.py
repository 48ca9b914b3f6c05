"""Every command with its words, as help tells them."""

from __future__ import annotations

import os
from pathlib import Path

import commands


class Commands:
    """Command lines without a terminal."""

    def __init__(self, folder: Path, state: Path) -> None:
        self.folder = folder
        found = {k: v for k, v in os.environ.items() if k not in ("VISUAL", "EDITOR")}
        self.environment = {**found, "RORG_STATE_DIR": str(state), "RORG_ENGINE": "process"}

    def __call__(self, words: list[str], **environment: str) -> tuple[int, str, str]:
        done = commands.run(words, {**self.environment, **environment}, self.folder)
        return done.returncode, done.stdout, done.stderr
