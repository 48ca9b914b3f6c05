"""The rooms, and who may import whom (docs/explanation/architecture.md)."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import rorg

ROOT = Path(rorg.__file__).parent
ROOMS = ["cli", "daemon", "sim", "engines", "host", "store", "core", "manifest"]
"""A room imports only itself and rooms after it; `errors` and `client` stand beside them."""
PURE = {"os", "time", "random", "subprocess", "socket", "threading", "docker", "psutil", "pathlib", "datetime",
        "uuid", "pydantic"}
FILES = sorted(p for p in ROOT.rglob("*.py") if p.parent != ROOT)


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_room_imports_only_rooms_below_it(path):
    room = path.relative_to(ROOT).parts[0]
    for module in imports(path):
        parts = module.split(".")
        if parts[0] == "rorg" and len(parts) > 1 and parts[1] not in ("errors", "client"):
            assert ROOMS.index(parts[1]) >= ROOMS.index(room), f"{room} imports {module}"
        if room == "core":
            assert parts[0] not in PURE, f"core imports {module}"


def test_files_are_small():
    long = {str(p.relative_to(ROOT)): n for p in FILES if (n := len(p.read_text().splitlines())) > 350}
    assert not long, "is there a second subject in them?"
