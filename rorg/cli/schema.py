"""rorg schema"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from rorg.cli.options import Argument
from rorg.cli.output import note
from rorg.errors import Invalid


def command(
    directory: Annotated[Path, Argument("Directory to write to; created if missing.")] = Path("schemas"),
) -> None:
    """Write the JSON schemas of manifests, which editors use to complete and check them.

    Example: rorg schema schemas
    """
    from rorg.manifest.schema import write

    try:
        written = write(directory, check=False)
    except OSError as error:
        raise Invalid(
            f"write schemas into {directory}", f"{error.filename}: {error.strerror}", "another one"
        ) from error
    note(f"{directory}: {', '.join(written)} written" if written else f"{directory} is up to date")
