"""What a command that leaves nothing behind has left."""

from __future__ import annotations

from pathlib import Path


def left_behind(folder: Path, prefix: str) -> list[str]:
    """Folders that it made in this one for its robots, and processes of these that run: services, and rorg itself."""
    marks = [f"{name}={folder}/".encode() for name in ("RORG_EXIT", "RORG_STATE_DIR")]
    found = [p.name for p in folder.glob(f"{prefix}*")]
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                environment = (entry / "environ").read_bytes()
                if any(mark in environment for mark in marks):
                    found.append(entry.name)
            except OSError:
                continue
    return found
