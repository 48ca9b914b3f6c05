"""rorg cp"""

from __future__ import annotations

import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from rorg.cli.exec import container_of
from rorg.cli.options import RobotEngine
from rorg.engines.unpack import unpack
from rorg.errors import Invalid, Refused

STREAM = "-"

Place = Annotated[str, typer.Argument(help="SERVICE:PATH, or a path on this machine; one of each. - is a tar stream.")]


def command(context: RobotEngine, source: Place, target: Place) -> None:
    """Copy files or directories out of a service or into it.

    Example: rorg cp navigation:/root/map.yaml .
    """
    what = f"copy {source} to {target}"
    (from_service, origin), (to_service, place) = _parted(source), _parted(target)
    if bool(from_service) == bool(to_service) or not (origin and place):
        raise Invalid(
            what, "one of the two must be SERVICE:PATH, the other a path of this machine", "`rorg cp SERVICE:/path .`"
        )
    if from_service and place != STREAM and not Path(place).absolute().parent.is_dir():
        raise Invalid(what, f"no directory {Path(place).parent}", "to create it first")
    if to_service and origin != STREAM and not Path(origin).exists():
        raise Invalid(what, f"no such file: {origin}", "another path")
    if from_service and place == STREAM and sys.stdout.isatty():
        raise Refused(what, "a terminal cannot show a tar stream", "to redirect it: > FILE")
    container, engine = container_of(context, from_service or to_service, what), context.engine()
    if STREAM in (origin, place):
        with tempfile.TemporaryDirectory(prefix="rorg-cp-") as folder:
            if from_service:
                engine.fetch(container.id, origin, Path(folder))
                _write(Path(folder))
            else:
                for path in _read(Path(folder), what):
                    engine.put(container.id, path, place)
    elif from_service:
        engine.fetch(container.id, origin, Path(place))
    else:
        engine.put(container.id, Path(origin), place)


def _write(folder: Path) -> None:
    """Writes what is in a folder as a tar stream, as `docker cp` does."""
    with tarfile.open(fileobj=sys.stdout.buffer, mode="w|") as archive:
        for path in folder.iterdir():
            archive.add(path, path.name)


def _read(folder: Path, what: str) -> list[Path]:
    """Unpacks a tar stream; what is at its top. Raises Invalid."""
    try:
        with tarfile.open(fileobj=sys.stdin.buffer, mode="r|*") as archive:
            unpack(archive, folder, archive, links=True)
    except (tarfile.TarError, OSError, EOFError) as error:
        raise Invalid(
            what, f"standard input is no tar stream that can be unpacked: {error}", "`tar c FILE |`"
        ) from error
    return sorted(folder.iterdir())


def _parted(text: str) -> tuple[str, str]:
    """(service, path inside), or ("", path here): a text with a / before its first colon is a path, as in ./a:b."""
    service, colon, path = text.partition(":")
    return (service, path) if colon and service and "/" not in service else ("", text)
