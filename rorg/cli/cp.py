"""rorg cp"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from rorg.cli.exec import container_of
from rorg.cli.options import Argument, RobotEngine
from rorg.errors import Invalid

Place = Annotated[str, Argument("SERVICE:PATH, or a path on this machine; one of each.")]


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
    if from_service and not Path(place).is_dir() and not Path(place).absolute().parent.is_dir():
        raise Invalid(what, f"no directory {Path(place).parent}", "to create it first")
    if to_service and not Path(origin).exists():
        raise Invalid(what, f"no such file: {origin}", "another path")
    container = container_of(context, from_service or to_service, what)
    if from_service:
        context.engine().fetch(container.id, origin, Path(place))
    else:
        context.engine().put(container.id, Path(origin), place)


def _parted(text: str) -> tuple[str, str]:
    """(service, path inside), or ("", path here): a text with a / before its first colon is a path, as in ./a:b."""
    service, colon, path = text.partition(":")
    return (service, path) if colon and service and "/" not in service else ("", text)
