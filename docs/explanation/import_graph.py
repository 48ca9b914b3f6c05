"""Draws the imports between the rooms of rorg into architecture.md: `import_graph.py [--check]`.

`read_imports` is the only reader of imports; tests/project/test_layers.py uses it to check the rules of the rooms.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = Path(__file__).with_name("architecture.md")
BEGIN, END = "<!-- begin: import_graph.py -->", "<!-- end: import_graph.py -->"


@dataclass(frozen=True, slots=True)
class Import:
    """One module that a file imports, with its full name."""

    module: str
    line: int
    late: bool = False
    """The import is inside a function, so it happens when that is called."""
    typing: bool = False
    """The import is under TYPE_CHECKING, so it never happens at run time."""


def files(package: str = "rorg") -> list[Path]:
    """Every Python file of a package."""
    return sorted((ROOT / package).rglob("*.py"))


def module_of(path: Path) -> str:
    """The dotted name of a file."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room_of(module: str) -> str:
    """The room of a module, a folder of rorg/ or of rorg/tools/; "" for modules beside the rooms."""
    parts = module.split(".")[1:]
    room = "/".join(parts[:2] if parts[:1] == ["tools"] else parts[:1])
    return room if room != "tools" and room and (ROOT / "rorg" / room).is_dir() else ""


def read_imports(path: Path) -> list[Import]:
    """All imports of a file, in order."""
    return list(_walk(ast.parse(path.read_text(encoding="utf-8")), path, False, False))


def _walk(node: ast.AST, path: Path, late: bool, typing: bool) -> Iterator[Import]:
    if isinstance(node, ast.Import):
        yield from (Import(alias.name, node.lineno, late, typing) for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = _base(node, path)
        names = dict.fromkeys(_module(base, alias.name) for alias in node.names)
        yield from (Import(name, node.lineno, late, typing) for name in names)
    late = late or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
    guarded = node.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test) else ()
    for child in ast.iter_child_nodes(node):
        yield from _walk(child, path, late, typing or child in guarded)


def _base(node: ast.ImportFrom, path: Path) -> str:
    if not node.level:
        return node.module or ""
    package = [*path.relative_to(ROOT).parent.parts][: -(node.level - 1) or None]
    return ".".join([*package, *([node.module] if node.module else [])])


def _module(base: str, name: str) -> str:
    """`from base import name`: the module `base.name` where there is one."""
    folder = ROOT.joinpath(*base.split("."))
    return f"{base}.{name}" if (folder / f"{name}.py").exists() or (folder / name / "__init__.py").exists() else base


def arrows() -> dict[str, set[str]]:
    """Room -> the rooms that it imports from."""
    found: dict[str, set[str]] = {}
    for path in files():
        room = room_of(module_of(path))
        if room:
            there = {room_of(i.module) for i in read_imports(path) if i.module.split(".")[0] == "rorg"}
            found.setdefault(room, set()).update(there - {room, ""})
    return found


def reduced(graph: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The graph without arrows that a longer path implies."""

    def reach(room: str) -> set[str]:
        return {far for near in graph[room] for far in (near, *reach(near))}

    return {room: {near for near in below if not any(near in reach(o) for o in below)} for room, below in graph.items()}


def drawing() -> str:
    """The block of architecture.md."""
    rooms = reduced(arrows())
    lines = [f"  {_node(room)} --> {_node(near)}" for room, below in sorted(rooms.items()) for near in sorted(below)]
    tools = [f"    {_node(room)}" for room in sorted(rooms) if _node(room) != room]
    return "\n".join([BEGIN, "", "```mermaid", "graph TD", "  subgraph tools", *tools, "  end", *lines, "```", "", END])


def _node(room: str) -> str:
    return room.removeprefix("tools/")


def main() -> None:
    """Writes the block; with `--check`, exits if it is out of date."""
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    _, found, after = rest.partition(END)
    if not found:
        sys.exit(f"cannot draw the rooms: {PAGE.name} has no markers; try a line {BEGIN} and one {END}")
    new = before + drawing() + after
    if new != page and "--check" in sys.argv:
        sys.exit(f"stale: {PAGE.name}; try `make docs`")
    if new != page:
        PAGE.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
