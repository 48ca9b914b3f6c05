"""What simulates a robot and what runs one decide by the same objects, and no decision asks which of the two it is."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest
from import_graph import files, module_of, read_imports

DECIDING = ("decide", "finish", "desire", "Inputs", "DispatchLimits")
"""Of core: a pass, what it reads, and what becomes of its actions."""


def reached(module: str) -> set[str]:
    """All modules of rorg that one imports, by way of others too."""
    paths = {module_of(path): path for path in files()}
    found, pending = set[str](), [module]
    while pending:
        name = pending.pop()
        if name in paths and name not in found:
            found.add(name)
            pending += [i.module for i in read_imports(paths[name])]
    return found


@pytest.mark.slow
def test_both_reach_the_same_planner():
    planner = reached("rorg.core.decide")
    assert len(planner) > 20, "is anything found?"
    for user in ("rorg.tools.sim.simulate", "rorg.tools.sim.emulate", "rorg.daemon.loop"):
        if user in map(module_of, files()):
            assert planner <= reached(user), user


def test_they_call_the_same_objects():
    sim, loop, tree = (
        importlib.import_module(f"rorg.{name}") for name in ("tools.sim.robot", "daemon.loop", "daemon.tree")
    )
    assert sim.decide is importlib.import_module("rorg.core.decide").decide
    for name in DECIDING:
        assert getattr(sim, name) is getattr(tree if name == "desire" else loop, name), name


def texts(path: Path) -> set[str]:
    """Literal texts of a file, without what documents it."""
    tree = ast.parse(path.read_text())
    told = {n.value for n in ast.walk(tree) if isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant)}
    return {
        n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str) and n not in told
    }


def names(path: Path) -> set[str]:
    tree = ast.parse(path.read_text())
    found = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)}
    return found | {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}


@pytest.mark.slow
@pytest.mark.parametrize("room", ["core", "model", "daemon", "engines", "probes", "host", "store", "history"])
def test_nobody_below_asks_whether_it_is_simulated(room):
    for path in files(f"rorg/{room}"):
        assert not {t for t in texts(path) if t == "sim" or "simulat" in t.lower()}, path
        assert not {n for n in names(path) if "simul" in n.lower() or n.lower().startswith("sim")}, path
        assert not {i.module for i in read_imports(path) if i.module.startswith("rorg.tools.sim")}, path


@pytest.mark.slow
def test_no_branch_is_on_the_name_of_the_sim_engine():
    for path in files():
        if path.parent.name != "sim":
            assert "sim" not in texts(path), path
