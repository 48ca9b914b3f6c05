"""Trees of tests/cases/findings/*.yaml: one with a mistake, and one that does the same without it."""

from __future__ import annotations

import textwrap
from pathlib import Path


def build(root: Path, files: dict[str, str]) -> Path:
    """A tree of files by path, and of services by name, of which only the spec is said. A text that begins with
    `-> ` is a link, one with `+x ` may be executed."""
    for name, text in files.items():
        path = root / (name if "/" in name else f"services/{name}.yaml")
        path.parent.mkdir(parents=True, exist_ok=True)
        if "/" not in name:
            head = f"apiVersion: rorg/v1\nkind: Service\nmetadata: {{name: {name}}}\nspec:\n"
            text = head + textwrap.indent(text, "  ")
        if text.startswith("-> "):
            path.symlink_to(text[3:])
            continue
        path.write_bytes(text.removeprefix("+x ").encode())
        path.chmod(0o755 if text.startswith("+x ") else 0o644)
    return root
