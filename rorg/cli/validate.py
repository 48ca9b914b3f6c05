"""rorg validate"""

from __future__ import annotations

import sys

from rorg.cli.options import Directory, Output


def command(directory: Directory = None, output: Output = "table") -> None:
    """Check manifests: everything that is wrong, with file:line:column. Needs no engine."""
    from pathlib import Path

    from rorg.cli.output import check_form, dump, note
    from rorg.errors import Exit
    from rorg.manifest.load import load

    check_form(output, ("table", "json", "yaml"))
    root = directory or (Path("manifests") if Path("manifests").is_dir() else Path("."))
    loaded = load(root)
    if output != "table":
        dump([d.as_json() for d in loaded.diagnostics], output)
    for diagnostic in loaded.diagnostics if output == "table" else ():
        note(str(diagnostic))
    if loaded.catalog is None:
        note(f"{len(loaded.errors)} error(s): nothing would be changed by these manifests")
        sys.exit(int(Exit.USAGE))
    found = loaded.catalog
    counts = {
        "service": sum(not s.meta for s in found.services.values()),
        "group": len(found.groups),
        "image": len(found.images),
        "standing request": len(found.requests),
    }
    note("ok: " + ", ".join(f"{n} {what}{'s' * (n != 1)}" for what, n in counts.items() if n or what == "service"))
