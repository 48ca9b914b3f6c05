"""rorg export"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rorg.cli.kinds import FILE
from rorg.cli.options import TreeAlone
from rorg.cli.output import disk_errors, dump, echo, note
from rorg.errors import Refused
from rorg.model.units import counted

if TYPE_CHECKING:
    from rorg.tools.compose.writer_text import Exported

FORMATS = ("compose",)
FORMS = ("yaml", "json")


def command(
    context: TreeAlone,
    format: Annotated[Literal["compose"], typer.Argument(help="compose.")],  # noqa: ARG001 - there is one
    output: Annotated[
        Path | None,
        typer.Option(
            help="The Compose file to write; it and the files beside it must not exist. Default: standard output.",
            click_type=FILE,
        ),
    ] = None,
    form: Annotated[
        Literal["yaml", "json"],
        typer.Option("-o", help="yaml, or json: the file, what it cannot express, and the files beside it."),
    ] = "yaml",
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
) -> None:
    """Write the robot as a Compose file: every container option, needs, image builds, networks and volumes, without
    requests. Comments in the file say what Compose cannot express.

    Example: rorg export compose --output compose.yaml
    """
    from rorg.tools.compose.writer import export

    catalog = context.catalog()
    root = context.root.resolve()
    base = (output.parent if output else Path(".")).resolve()
    name = context.robot or (root.parent.name if root.name == "manifests" else root.name)
    exported = export(catalog, str(base), name)
    if output:
        _write(exported, output, force)
    _tell(exported, output, form)


def _write(exported: Exported, output: Path, force: bool) -> None:
    """Writes the file and before it those that it names, each in one step; those with secrets only for their owner."""
    from rorg.store.files import clear_leftovers, write_atomic
    from rorg.tools.compose.writer_text import write

    texts = {output: write(exported), **{output.parent / name: text for name, text in exported.files.items()}}
    there = [str(path) for path in texts if path.exists()]
    if there and not force:
        raise Refused("export the robot", f"{', '.join(there)} exists already", "--force, or another --output")
    with disk_errors(f"write {output}", "another --output"):
        output.parent.mkdir(parents=True, exist_ok=True)
        os.umask(mask := os.umask(0))
        for path, text in reversed(texts.items()):
            clear_leftovers(path.parent, path.name)
            write_atomic(path, text, mode=0o600 if path.suffix == ".env" else 0o644 & ~mask)


def _tell(exported: Exported, output: Path | None, form: str) -> None:
    from rorg.tools.compose.writer_text import escaped, write

    if form == "json":
        report: dict[str, Any] = {
            "file": str(output) if output else None,
            "compose": escaped(exported.document),
            "notes": [n.as_json() for n in exported.notes],
            "files": sorted(exported.files),
        }
        dump(report, "json")
    elif output is None:
        echo(write(exported), end="")
    if output is None and exported.files:
        note(f"{', '.join(sorted(exported.files))}: the file names these; --output writes them too")
    lost = sum(n.lost for n in exported.notes)
    told = f", {counted(lost, 'thing')} not carried: see its comments" if lost else ""
    note(f"{output or 'compose'}: {counted(len(exported.document['services']), 'service')}{told}")
