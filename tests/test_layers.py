"""The rooms, and who may import whom (docs/explanation/architecture.md)."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rorg
from rorg.model.live import LIVE

ROOT = Path(rorg.__file__).parent
ROOMS = [
    "cli",
    "api",
    "sim",
    "daemon",
    "images",
    "probes",
    "engines",
    "host",
    "store",
    "manifest",
    "core",
    "model",
]
"""A room imports only itself and rooms after it; `errors` and `client` stand beside them. `manifest` and `core` are
siblings: neither imports the other."""
SIBLINGS = {"manifest": "core", "core": "manifest"}
PURE = {
    "os",
    "time",
    "random",
    "subprocess",
    "socket",
    "threading",
    "docker",
    "psutil",
    "pathlib",
    "datetime",
    "uuid",
    "pydantic",
    "yaml",
}
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
            assert SIBLINGS.get(room) != parts[1], f"{room} imports {module}"
        if room in ("core", "model"):
            allowed = {"datetime"} if room == "model" else set()  # to write times, not to ask for them
            assert parts[0] not in PURE - allowed, f"{room} imports {module}"


def test_the_core_loads_neither_yaml_nor_pydantic():
    code = "import sys, rorg.core.decide; sys.exit(bool({'yaml', 'pydantic', 'docker'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_what_the_core_takes_for_live_is_what_the_fields_are_marked_as():
    from rorg.manifest.container import ContainerOptions

    marked = {
        name
        for name, field in ContainerOptions.model_fields.items()
        if (field.json_schema_extra or {}).get("x-rorg-change") == "live"
    }
    assert marked == LIVE


def test_files_are_small():
    long = {str(p.relative_to(ROOT)): n for p in FILES if (n := len(p.read_text().splitlines())) > 350}
    assert not long, "is there a second subject in them?"
