"""The folders of tests/ (tests/README.md): few at the top, and no test imports another one."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from common import ROOT, TESTS

MOST_ENTRIES = 18
PASSING = {"__pycache__", ".hypothesis"}
FILES = [p for p in sorted(TESTS.rglob("*.py")) if "cases" not in p.parts and "ros2_nodes" not in p.parts]
"""Nodes of ROS 2 import the package `test_msgs`."""


def imported(path: Path) -> Iterator[str]:
    """The modules that a file imports, also inside functions and by name."""
    for node in ast.walk(ast.parse(path.read_text())):
        match node:
            case ast.Import():
                yield from (alias.name for alias in node.names)
            case ast.ImportFrom():
                yield node.module or ""
                yield from (f"{node.module}.{alias.name}" for alias in node.names)
            case ast.Call(func=ast.Attribute(attr="import_module"), args=[ast.Constant(value=str(name)), *_]):
                yield name


def is_of_tests(module: str) -> bool:
    """Whether a module is a test, or a conftest, which are not to be imported."""
    return any(re.match(r"test_|conftest$", part) for part in module.split("."))


def test_what_an_import_of_a_test_is():
    assert is_of_tests("test_cli")
    assert is_of_tests("conftest")
    assert is_of_tests("proof.test_disk")
    assert not is_of_tests("robots")
    assert not is_of_tests("rorg.cli.latest_test")


def test_no_file_imports_a_test():
    """What two tests share is a module of tests/support: a test that another one imports cannot be moved or changed."""
    found = {str(path.relative_to(TESTS)): [m for m in imported(path) if is_of_tests(m)] for path in FILES}
    assert len(found) > 200
    assert {path: modules for path, modules in found.items() if modules} == {}


def test_tests_need_no_path_of_their_own():
    """`pythonpath` in pyproject.toml has all of them; an entry that one test adds holds for all that follow it."""
    changing = re.compile(r"^sys\.path\.|^sys\.path\[", re.MULTILINE)
    assert [str(p) for p in FILES if p.name.startswith("test_") and changing.search(p.read_text())] == []


def test_the_top_has_few_entries_and_each_has_a_line():
    found = {path.name for path in TESTS.iterdir()} - PASSING
    assert len(found) <= MOST_ENTRIES
    text = (TESTS / "README.md").read_text()
    folders = {path.name for path in TESTS.iterdir() if path.is_dir()} - PASSING
    assert {name for name in folders if f"`{name}`" not in text} == set()


def test_the_folders_of_unit_are_those_of_rorg():
    folders = [p.relative_to(TESTS / "unit") for p in (TESTS / "unit").rglob("*") if p.is_dir()]
    assert [str(p) for p in folders if p.name not in PASSING and not (ROOT / "rorg" / p).is_dir()] == []


def test_every_test_is_in_a_folder():
    assert [path.name for path in TESTS.glob("test_*.py")] == []
