"""What a command that leaves nothing behind has left."""

from __future__ import annotations

from pathlib import Path


def left_behind(folder: Path, prefix: str) -> list[str]:
    """Folders that it made in this one for its robots, and processes of these that run."""
    found = [p.name for p in folder.glob(f"{prefix}*")]
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                if f"RORG_EXIT={folder}/".encode() in (entry / "environ").read_bytes():
                    found.append(entry.name)
            except OSError:
                continue
    return found
