"""rorg validate"""

from __future__ import annotations

import sys

from rorg.cli.options import Directory, Output


def command(directory: Directory = None, output: Output = "table") -> None:
    """Check manifests: everything that is wrong, with file:line:column. Needs no engine.

    Example: rorg validate manifests
    """
    from pathlib import Path

    from rorg.cli.output import check_form, note, print_rows
    from rorg.errors import Exit
    from rorg.manifest.load import load

    check_form(output)
    root = directory or (Path("manifests") if Path("manifests").is_dir() else Path("."))
    loaded = load(root)
    if output != "table":
        columns = ("file", "line", "column", "severity", "message", "remedy")
        print_rows([d.as_json() for d in loaded.diagnostics], output, columns)
    for diagnostic in loaded.diagnostics if output == "table" else ():
        note(str(diagnostic))
    if loaded.catalog is None:
        note(f"{len(loaded.errors)} error(s): nothing would be changed by these manifests")
        sys.exit(int(Exit.USAGE))
    count = sum(not s.meta for s in loaded.catalog.services.values())
    note(
        f"fine: {count} services, {len(loaded.catalog.groups)} groups, {len(loaded.catalog.images)} images, "
        f"{len(loaded.catalog.requests)} standing requests"
    )
