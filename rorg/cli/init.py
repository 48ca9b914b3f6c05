"""rorg init"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import typer

from rorg.cli.output import disk_errors, note
from rorg.errors import Invalid, Refused
from rorg.model.machines import PORT


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
MACHINES = ("body", "head", "arm", "lab")
"""Names for the machines of a first robot; the first one is the default."""
MACHINE = """# yaml-language-server: $schema=../schemas/machine.json
apiVersion: rorg/v1
kind: Machine
metadata: {{name: {name}}}
spec:
  address: localhost:{port}      # the name or address of that computer, and the port of its rorg
  {more}
"""
DEFAULT = "default: true                # services that name no machine run here"
LEASE = "lease: 10s                   # for so long requests of the others count here after a link has failed"
MOVED = Path("services/localization.yaml")
"""The service of the first robot that runs on the second machine."""
HIDDEN = ("gitignore", "vscode")
NEXT = """{name} is a robot of {services}{git}. Next:
{cd}  rorg validate                     # every mistake, with file:line:column
  rorg build                        # {build}
  rorg run                          # {run}
  {request}# in another terminal: it starts, with all that it needs
  rorg down                         # stop and remove everything; the files stay"""

TemplateName = Annotated[
    Literal["first", "ros2"],
    typer.Option(help="first: three small services. ros2: nodes of ROS 2, one of them managed."),
]
Directory = Annotated[Path, typer.Argument(help="Directory to write to; created if missing.", show_default=False)]


def command(
    directory: Directory = Path("."),
    *,
    template: TemplateName = "first",
    machines: Annotated[
        int, typer.Option(help="Computers of the robot, 1 to 4; with the template first.", metavar="N")
    ] = 1,
) -> None:
    """Write a first robot, ready to run: services with comments, schemas for editors, in git.

    Example: rorg init robot --template ros2
    """
    if not 1 <= machines <= len(MACHINES) or (machines > 1 and template != FIRST):
        why = f"there is a template for 1 to {len(MACHINES)} computers, without ROS"
        raise Invalid(f"write a robot of {machines} computers", why, "--machines 2")
    from rorg.manifest.schema import write

    chosen = TEMPLATES[template]
    places = {_place(path.relative_to(chosen.folder)): path for path in files(chosen.folder)}
    there = [str(place) for place in (*places, Path("schemas")) if (directory / place).exists()]
    if there:
        raise Refused(f"write a robot into {directory}", f"{', '.join(there)} already exists", "another directory")
    with disk_errors(f"write a robot into {directory}", "another one"):
        _refuse_others(directory)
        for place, path in places.items():
            (directory / place).parent.mkdir(parents=True, exist_ok=True)
            (directory / place).write_bytes(path.read_bytes())
        write(directory / "schemas", check=False)
        written = [*map(str, places), "schemas"]
        if machines > 1:
            written += _divide(directory, MACHINES[:machines])
    if machines > 1:
        chosen = chosen._replace(
            services=f"{chosen.services} on {machines} computers", run="see docs/tutorial-machines.md"
        )
    values = chosen._asdict() | {"request": f"rorg request {chosen.request} --wait".ljust(34)}
    change = "" if directory == Path(".") else f"  cd {directory}\n"
    note(NEXT.format(name=directory.resolve().name, git=_committed(directory, written), cd=change, **values))


def _refuse_others(directory: Path) -> None:
    """Raises Refused if the directory has manifests: they would be part of the robot, with their mistakes."""
    from rorg.manifest.documents import manifest_files

    if own := [str(path.relative_to(directory)) for path in manifest_files(directory)]:
        more = f" and {len(own) - 1} more" if len(own) > 1 else ""
        why = f"{own[0]}{more} would belong to the robot: rorg reads every YAML file there as a manifest"
        raise Refused(f"write a robot into {directory}", why, "another directory")


def _divide(directory: Path, names: Sequence[str]) -> list[str]:
    """Declares the machines, and gives a service to the second one. Returns the new files."""
    (directory / "machines").mkdir(exist_ok=True)
    declared = [f"machines/{name}.yaml" for name in names]
    for index, (name, place) in enumerate(zip(names, declared, strict=True)):
        text = MACHINE.format(name=name, port=PORT + index, more=LEASE if index else DEFAULT)
        (directory / place).write_text(text, encoding="utf-8")
    text = (directory / MOVED).read_text(encoding="utf-8")
    (directory / MOVED).write_text(text.replace("spec:\n", f"spec:\n  machine: {names[1]}\n", 1), encoding="utf-8")
    return declared


def files(template: Path) -> Iterator[Path]:
    """The files of a template, also those below its links, which lead to other parts of rorg."""
    for folder, folders, names in os.walk(template, followlinks=True):
        folders[:] = sorted(name for name in folders if name != "__pycache__")
        yield from (Path(folder) / name for name in sorted(names))


def _place(place: Path) -> Path:
    """The place of a file of the template, where hidden names have no dot so that no tool obeys them here."""
    return Path(f".{place}") if place.parts[0] in HIDDEN else place


def _committed(directory: Path, written: list[str]) -> str:
    """Commits what is written to git with the user's identity, and no other file; a text about the result. Files that
    the user staged before stay staged."""
    import subprocess

    from rorg.host.git_process import git_command

    def git(*words: str) -> bool:
        return subprocess.run(["git", "-C", directory, *words], capture_output=True).returncode == 0

    try:
        if not git("rev-parse", "--git-dir") and not git("init", "--quiet"):
            return ""
        git("add", "--", *written)
        done = git("commit", "--quiet", "--message", "A first robot", "--", *written)
        command = git_command(directory, "commit", "--message", "A first robot")
        return ", in git" if done else f"; commit it: `{command}`"
    except OSError:  # there is no git here; rorg works without it
        return ""
