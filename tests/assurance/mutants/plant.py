"""Plants a mutant in the modules that are imported already: what holds the old code or value gets the new one."""

from __future__ import annotations

import ast
import gc
import inspect
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

from mutants.operators import Mutant

import rorg.core

FOLDER = Path(rorg.core.__file__).parent
ATOMS = int, float, str, bool, tuple, frozenset, type(None)
"""Python may share these, so one of them is only known by its name."""
Key = tuple[str, str, int]
"""Of code: its file, qualified name and first line."""


class Core:
    """The modules of rorg.core, by the names of their files, and what has their code."""

    def __init__(self) -> None:
        self.paths = {path.name: path for path in sorted(FOLDER.glob("*.py")) if path.stem != "__init__"}
        self.modules = {name: import_module(f"rorg.core.{path.stem}") for name, path in self.paths.items()}
        self.functions: dict[Key, list[FunctionType]] = {}
        for one in gc.get_objects():
            if isinstance(one, FunctionType) and Path(one.__code__.co_filename).parent == FOLDER:
                self.functions.setdefault(_key(one.__code__), []).append(one)

    def plant(self, mutant: Mutant, tree: ast.Module) -> None:
        """Make this process the mutant; `tree` is what the mutant is of. Only for a process that ends soon."""
        module = self.modules[mutant.file]
        mutant.apply()
        for code in _codes(compile(tree, str(self.paths[mutant.file]), "exec")):
            for function in self.functions.get(_key(code), ()):
                if function.__code__ != code:
                    function.__code__ = code
        if not mutant.inside:
            _replace(module, mutant.top)


def _key(code: CodeType) -> Key:
    return code.co_filename, code.co_qualname, code.co_firstlineno


def _codes(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _codes(constant)


def _replace(module: ModuleType, statement: ast.stmt) -> None:
    """Execute a statement of a module anew, and hand what it makes to whoever has what it made before."""
    names = dict(vars(module))
    exec(compile(ast.Module([statement], []), str(module.__file__), "exec"), names)
    for name in {n for n, value in names.items() if n != "__builtins__" and vars(module).get(n) is not value}:
        old, new = vars(module)[name], names[name]
        if isinstance(statement, ast.ClassDef):
            for attribute, value in vars(new).items():
                _hand_over(vars(old).get(attribute), value)
                if isinstance(value, ATOMS) and not attribute.startswith("__"):
                    setattr(old, attribute, value)
        elif isinstance(statement, ast.FunctionDef):
            _hand_over(old, new)
        else:
            _rebind(name, old, new)


def _hand_over(old: object, new: object) -> None:
    """Give a function the defaults of another."""
    before, after = _function(old), _function(new)
    if before and after:
        before.__defaults__, before.__kwdefaults__ = after.__defaults__, after.__kwdefaults__


def _function(value: object) -> FunctionType | None:
    inner = getattr(value, "fget", None) or getattr(value, "__func__", None) or getattr(value, "func", None) or value
    found = inspect.unwrap(inner) if callable(inner) else None
    return found if isinstance(found, FunctionType) else None


def _rebind(name: str, old: object, new: object) -> None:
    for module in list(sys.modules.values()):
        for known, value in list(vars(module).items()) if isinstance(module, ModuleType) else ():
            if value is old and (known == name or not isinstance(old, ATOMS)):
                vars(module)[known] = new
