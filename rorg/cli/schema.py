"""rorg schema"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rorg.cli.output import disk_errors, note


def command(
    directory: Annotated[Path, typer.Argument(help="Directory to write to; created if missing.")] = Path("schemas"),
) -> None:
    """Write the JSON schemas of manifests, which editors use to complete and check them.

    Example: rorg schema schemas
    """
    from rorg.manifest.schema import write

    with disk_errors(f"write schemas into {directory}", "another one"):
        written = write(directory, check=False)
    note(f"{directory}: {', '.join(written)} written" if written else f"{directory} is up to date")
