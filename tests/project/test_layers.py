"""The rooms (docs/explanation/architecture.md): who may import whom, what each loads, and how large anything may be."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from fnmatch import fnmatch
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from subprocess import run

import pytest
from common import ROOT as TOP
from import_graph import Import, files, module_of, read_imports, room_of

from rorg.model.options import LIVE

ROOMS = [
    "cli",
    "tools/importing",
    "tools/sim",
    "tools/compose",
    "plots",
    "web",
    "api",
    "daemon",
    "images",
    "probes",
    "engines",
    "history",
    "host",
    "store",
    "manifest",
    "core",
    "model",
]
"""A room imports only itself and rooms after it."""
SIBLINGS = {"manifest": "core", "core": "manifest"}
"""Neither imports the other."""
GROUND = {"rorg", "rorg.errors", "rorg.client", "rorg.regular_file"}
"""What stands beside the rooms, and they may all import."""
ALONE = {"__init__.py", "__main__.py", "errors.py", "client.py", "regular_file.py", "py.typed"}
"""Files beside the rooms."""
IMPURE = {"os", "time", "random", "subprocess", "socket", "threading", "pathlib", "datetime", "uuid"}
"""Of the standard library: what asks the world. model may have datetime, to write times, not to ask for them."""
DIRECT: dict[str, set[str]] = {
    "cli": {"psutil", "rich", "rorg_client", "typer", "yaml"},
    "tools/importing": {"yaml"},
    "web": {"rorg_client", "starlette", "uvicorn"},
    "api": {"fastapi", "prometheus_client", "pydantic", "starlette", "uvicorn"},
    "tools/sim": {"matplotlib"},
    "plots": {"matplotlib", "pygraphviz"},
    "daemon": set(),
    "images": {"docker", "networkx", "requests", "urllib3"},
    "probes": set(),
    "engines": {"docker"},
    "history": set(),
    "host": {"psutil", "watchfiles"},
    "store": {"yaml"},
    "tools/compose": {"yaml"},
    "manifest": {"pydantic", "re2", "yaml"},
    "core": set(),
    "model": set(),
}
"""Packages that the files of a room may name, also inside functions."""
LOADED: dict[str, set[str]] = {
    **DIRECT,
    "cli": DIRECT["cli"] | {"pydantic", "watchfiles"},  # by the demo, and by what commands compute themselves
    "tools/importing": {"pydantic", "re2", "yaml"},
    "tools/sim": {"psutil", "pydantic", "re2", "watchfiles", "yaml"},  # by the loop of an emulated robot
    "web": DIRECT["web"] | {"httptools", "watchfiles"},
    "api": DIRECT["api"] | {"httptools", "psutil", "watchfiles", "yaml"},
    "daemon": {"psutil", "pydantic", "watchfiles", "yaml"},
    "images": {*DIRECT["images"], "pydantic", "psutil", "yaml"},
    "tools/compose": {"pydantic", "re2", "yaml"},
    "engines": DIRECT["engines"] | {"pydantic", "psutil"},  # options of containers are pydantic's fields
}
"""Those that are there once all files of a room are loaded, by way of others too."""
HEAVY = set().union(*DIRECT.values(), {"httptools", "uvloop"}) - {"rorg_client", "typer"}
"""What no command may load before it needs it."""
COMPUTING = {
    *("rorg.cli.offline", "rorg.cli.local_apply", "rorg.cli.dev_containers", "rorg.cli.local", "rorg.cli.top_screen"),
    *("rorg.cli.goals", "rorg.cli.revert", "rorg.cli.past_requests"),
}
"""What commands load once they must compute something themselves, use the engine, or draw a screen."""
HERE = {
    *("pyproject.toml", "Makefile", ".ci", ".gitignore", "LICENSE", "README.md", "CHANGELOG.md", "CONTRIBUTING.md"),
    *("SECURITY.md", "changelog.d", ".github", ".editorconfig", ".pre-commit-config.yaml"),
    *("rorg", "clients", "manifests", "schemas", "images", "tests", "docs"),
}
"""All that the top of the repository holds."""
MODULES = {module_of(path): path for path in files()}
MOST_LINES, MOST_OF_A_FUNCTION, MOST_BY_POSITION = 300, 40, 7


def of_rorg(path: Path) -> Iterator[Import]:
    yield from (i for i in read_imports(path) if i.module.partition(".")[0] == "rorg" and i.module not in GROUND)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_rooms_below_it(room):
    allowed = set(ROOMS[ROOMS.index(room) :]) - {SIBLINGS.get(room, "")}
    for path in files(f"rorg/{room}"):
        wrong = [f"{path}:{i.line}: {i.module}" for i in of_rorg(path) if room_of(i.module) not in allowed]
        assert not wrong, f"{room} stands below what it imports"


@pytest.mark.slow
def test_no_file_imports_itself_by_way_of_others():
    """Imports inside functions count, and those for types: a value that two files share stands in the lower one."""
    graph = {module: {i.module for i in of_rorg(path)} - {module} for module, path in MODULES.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


@pytest.mark.parametrize("room", ["core", "model"])
def test_what_decides_asks_nobody(room):
    forbidden = IMPURE - ({"datetime"} if room == "model" else set())
    for path in files(f"rorg/{room}"):
        assert not {i.module.partition(".")[0] for i in read_imports(path)} & forbidden, path


@pytest.mark.parametrize("room", ROOMS)
def test_the_packages_that_a_room_names(room):
    for path in files(f"rorg/{room}"):
        named = {i.module.partition(".")[0] for i in read_imports(path)} - {"rorg"} - set(sys.stdlib_module_names)
        assert named <= DIRECT[room], path


def loaded(*modules: str) -> set[str]:
    """The packages that are there in a new Python once these modules are, without what it begins with."""
    code = f"""
import importlib, sys
before = set(sys.modules)
for module in {modules!r}: importlib.import_module(module)
print(*{{name.partition(".")[0] for name in set(sys.modules) - before}})"""
    found = run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    return set(found.stdout.split()) - {"rorg"} - set(sys.stdlib_module_names)


@pytest.mark.slow
@pytest.mark.parametrize("room", ROOMS)
def test_the_packages_that_a_room_loads(room):
    found = loaded(*(module_of(path) for path in files(f"rorg/{room}")))
    known = set().union(*LOADED.values())
    assert found & known <= LOADED[room]
    assert LOADED[room] or not found, "not even what others bring along"


def test_commands_load_nothing_heavy_before_they_need_it():
    commands = [module_of(path) for path in files("rorg/cli") if path.parent.name == "cli"]
    assert not loaded(*(m for m in commands if m not in COMPUTING)) & HEAVY


def test_what_the_core_takes_for_live_is_what_the_fields_are_marked_as():
    from rorg.manifest.container import ContainerOptions

    marked = {
        name
        for name, field in ContainerOptions.model_fields.items()
        if (field.json_schema_extra or {}).get("x-rorg-change") == "live"
    }
    assert marked == LIVE


def test_every_file_is_in_a_room():
    for path in (TOP / "rorg").rglob("*"):
        inner = path.relative_to(TOP / "rorg")
        if "__pycache__" in inner.parts or path.is_dir() or path.is_symlink():
            continue
        if len(inner.parts) == 1:
            assert inner.name in ALONE, inner
        else:
            assert room_of(module_of(path)) in ROOMS or str(inner) == "tools/__init__.py", inner
            assert inner.suffix == ".py" or inner.parts[:2] in (
                ("manifest", "profiles"),
                ("web", "page"),
                ("cli", "first_robot"),
                ("cli", "fields.txt"),
            ), inner


def test_the_top_of_the_repository_holds_what_is_listed():
    passing = [".git", *(line.strip("/") for line in (TOP / ".gitignore").read_text().split())]
    found = {path.name for path in TOP.iterdir() if not any(fnmatch(path.name, pattern) for pattern in passing)}
    assert found <= HERE


def test_files_are_small():
    large = {str(p.relative_to(TOP)) for p in files() if len(p.read_text().splitlines()) > MOST_LINES}
    assert not large, "is there a second subject in them?"


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Every function of rorg, with its file and name."""
    for path in files():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield f"{path.relative_to(TOP)}: {node.name}", node


@pytest.mark.slow
def test_functions_are_short():
    long = {name for name, node in functions() if node.end_lineno - node.lineno >= MOST_OF_A_FUNCTION}
    assert not long, "do they do one thing?"


@pytest.mark.slow
def test_functions_take_few_parameters_by_position():
    many = {name for name, node in functions() if len(node.args.posonlyargs + node.args.args) > MOST_BY_POSITION}
    assert not many, "who can tell them apart where they are called?"
