"""rorg init"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, NamedTuple

from rorg.cli.options import Argument, Option
from rorg.cli.output import disk_errors, note
from rorg.errors import Refused


class Template(NamedTuple):
    """A robot to begin with."""

    folder: Path
    services: str
    build: str
    run: str
    request: str


FIRST, ROS2 = "first", "ros2"
TEMPLATES = {
    FIRST: Template(
        folder=Path(__file__).parent / "first_robot",
        services="three services",
        build="on Docker, once: fetch the images",
        run="the loop; without Docker: rorg run --engine process",
        request="navigation",
    ),
    ROS2: Template(
        folder=Path(__file__).parent / "ros2_robot",
        services="five services with ROS 2",
        build="once: fetch ROS 2, and build the image of this robot",
        run="the loop",
        request="tour",
    ),
}
HIDDEN = ("gitignore", "vscode")
NEXT = """{name} is a robot of {services}{git}. Next:
{cd}  rorg validate                     # every mistake, with file:line:column
  rorg build                        # {build}
  rorg run                          # {run}
  {request}# in another terminal: it starts, with all that it needs
  rorg down                         # stop and remove everything; the files stay"""


def command(
    directory: Annotated[Path, Argument("Directory to write to; created if missing.", show_default=False)] = Path("."),
    *,
    template: Annotated[
        str, Option("first: three small services. ros2: nodes of ROS 2, one of them managed.", choices=tuple(TEMPLATES))
    ] = FIRST,
) -> None:
    """Write a first robot, ready to run: services with comments, schemas for editors, in git.

    Example: rorg init robot --template ros2
    """
    from rorg.manifest.schema import write

    chosen = TEMPLATES[template]
    places = {_place(path.relative_to(chosen.folder)): path for path in files(chosen.folder)}
    there = [str(place) for place in (*places, Path("schemas")) if (directory / place).exists()]
    if there:
        raise Refused(f"write a robot into {directory}", f"{', '.join(there)} already exists", "another directory")
    with disk_errors(f"write a robot into {directory}", "another one"):
        for place, path in places.items():
            (directory / place).parent.mkdir(parents=True, exist_ok=True)
            (directory / place).write_bytes(path.read_bytes())
        write(directory / "schemas", check=False)
    written = sorted({"schemas", *(place.parts[0] for place in places)})
    values = chosen._asdict() | {"request": f"rorg request {chosen.request} --wait".ljust(34)}
    change = "" if directory == Path(".") else f"  cd {directory}\n"
    note(NEXT.format(name=directory.resolve().name, git=_committed(directory, written), cd=change, **values))


def files(template: Path) -> Iterator[Path]:
    """The files of a template, also those below its links, which lead to other parts of rorg."""
    for folder, folders, names in os.walk(template, followlinks=True):
        folders[:] = sorted(name for name in folders if name != "__pycache__")
        yield from (Path(folder) / name for name in sorted(names))


def _place(place: Path) -> Path:
    """The place of a file of the template, where hidden names have no dot so that no tool obeys them here."""
    return Path(f".{place}") if place.parts[0] in HIDDEN else place


def _committed(directory: Path, written: list[str]) -> str:
    """Commits what is written to git with the user's identity; a text about the result."""
    import subprocess

    def git(*words: str) -> bool:
        return subprocess.run(["git", "-C", directory, *words], capture_output=True).returncode == 0

    try:
        if not git("rev-parse", "--git-dir") and not git("init", "--quiet"):
            return ""
        git("add", "--", *written)
        done = git("commit", "--quiet", "--message", "A first robot", "--", *written)
        return ", in git" if done else "; commit it: `git commit -am 'A first robot'`"
    except OSError:  # there is no git here; rorg works without it
        return ""
