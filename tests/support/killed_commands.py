"""Commands that are killed at a write, and the files that they leave."""

from __future__ import annotations

from pathlib import Path

import commands
from common import SUPPORT

KILLED = str(SUPPORT / "programs/import_killed_at.py")


def run(folder: Path, *words: str) -> int:
    with (folder / "log").open("w") as log:
        process = commands.Forked([*words], cwd=folder, stdout=log, stderr=log, program=KILLED)
        try:
            return process.wait(90)
        finally:
            process.kill()


def files(tree: Path) -> dict[str, str]:
    return {str(p.relative_to(tree)): p.read_text() for p in sorted(tree.rglob("*")) if p.is_file()}
