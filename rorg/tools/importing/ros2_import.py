"""Imports a launch file of ROS 2: a Service for each program, and a Group of all of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rorg.manifest.yaml_text import Noted
from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic, Where
from rorg.tools.importing.launch_packages import Package, Packages, Read
from rorg.tools.importing.launch_programs import Launch, Node, Process, Program
from rorg.tools.importing.launch_values import LATE, Filler, Scope
from rorg.tools.importing.manifests import NOTE, Imported, Made, manifest_name
from rorg.tools.importing.ros2_commands import command, late
from rorg.tools.importing.ros2_file import launch_file, needs_file
from rorg.tools.importing.ros2_launch import LaunchReader

IMAGE = "ros:jazzy-ros-base"
"""Used if no other image is named."""
FOLDER = "launch"
"""Of generated launch files, in the tree; /launch in the container."""


def from_ros2(
    path: Path,
    package: Package,
    read: Read,
    arguments: Mapping[str, str],
    image: str,
    *,
    environment: Mapping[str, str],
    skip: bool,
) -> Imported:
    """The manifests of a launch file. One in Python is one service, because only Python can read it."""
    packages = Packages(package, read)
    reader = LaunchReader(Filler(packages, environment), skip)
    start = Where(str(path))
    try:
        if path.suffix == ".py":
            _python(reader, path, arguments, start)
        else:
            reader.file(path, Scope(variables=dict(arguments)), start)
            reader.finish()
    except TooMuch as bound:
        return Imported(diagnostics=tuple(sorted({*reader.found, bound.diagnostic})))
    if not reader.programs and not any(d.severity == "error" for d in reader.found):
        reader.found.append(Diagnostic(start, f"{path.name} starts nothing", "another file, or other arguments"))
    origin = f"From {path.name}{f' of the package {package.name}' if package.name else ''}"
    made, files = _services(reader.programs, origin, path, image)
    told = tuple(sorted({*reader.found, *_ties(reader.filler, made, files)}))
    if reader.fatal:
        return Imported(diagnostics=told)
    if len(made) > 1:
        made.append(_group(made, reader, path, origin, told))
    return Imported(tuple(made), files, diagnostics=told)


def _python(reader: LaunchReader, path: Path, arguments: Mapping[str, str], where: Where) -> None:
    """A launch file in Python is a program, which an import does not run."""
    try:
        reader.filler.packages.read(path)
    except OSError as error:
        reader.found.append(Diagnostic(where, f"cannot read {path}: {error.strerror}", "an existing file"))
        return
    message = f"{path.name} is written in Python, which an import does not run, so it becomes one service"
    remedy = "a launch file in XML or YAML that includes it, for parts of their own"
    reader.found.append(Diagnostic(where, message, remedy, NOTE))
    file = reader.filler.fill("$(filename)", Scope(), where)
    reader.programs.append(Launch(where=where, file=file, scope=Scope(variables=dict(arguments)), notes=(message,)))


def _ties(filler: Filler, made: list[Made], files: Mapping[str, str]) -> Iterator[Diagnostic]:
    """Notes about what the services take from this machine."""
    for name, where in filler.taken.items():
        message = f"$(env {name}) has the value of this import's environment from now on"
        yield Diagnostic(where, message, severity=NOTE)
    texts = "\n".join([*(word for one in made for word in one.spec["command"]), *files.values()])
    for folder, where in filler.local.items():
        if folder in texts:
            message = f"{folder} is on this machine, in no package, so the image does not have it"
            yield Diagnostic(where, message, f'container: {{volumes: ["{folder}:{folder}:ro"]}}', NOTE)


def _services(programs: list[Program], origin: str, path: Path, image: str) -> tuple[list[Made], dict[str, str]]:
    """The services, and the launch files that some of them need."""
    made, files = list[Made](), dict[str, str]()
    for program, name in zip(programs, _names(programs), strict=True):
        place = f", line {program.where.line}" if Path(program.where.file) == path else ""
        place = place or f", by {Path(program.where.file).name}, line {program.where.line}"
        comments = [f"{origin}{place}.", *program.notes]
        file = f"{FOLDER}/{name}.launch.xml" if needs_file(program) else ""
        if file:
            files[file] = launch_file(program, f"{origin}{place}; started by the service {name}.")
        if isinstance(program, Node) and program.components:
            comments.append(f"Its nodes: {', '.join(c.name or c.plugin for c in program.components)}.")
        spec: dict[str, Any] = {"image": image or Noted(IMAGE, "replace it by your workspace's image")}
        spec |= {"command": command(program, f"/{file}" if file else ""), "profile": "ros2"}
        if not (program.respawn or file or isinstance(program, Launch)):  # `ros2 launch` exits 0 in any case
            spec["restart"] = "on-failure"
        if container := _container(program, file):
            spec["container"] = container
        made.append(Made("Service", name, spec, tuple(comments)))
    return made, files


def _container(program: Program, file: str) -> dict[str, Any]:
    environment = {name: value for name, value in program.environment.items() if not late(value)}
    options: dict[str, Any] = {"environment": environment} if environment else {}
    if program.directory:
        options["working_dir"] = program.directory
    if file:
        options["volumes"] = [f"../{file}:/{file}:ro"]
    return options


def _names(programs: list[Program]) -> list[str]:
    """A name for each service: that of the node, with its namespace if several have it, and a number if still so."""
    plain = [manifest_name(_plain_name(program)) for program in programs]
    full = [
        manifest_name(f"{program.namespace}/{_plain_name(program)}".strip("/"))
        if isinstance(program, Node) and plain.count(name) > 1
        else name
        for program, name in zip(programs, plain, strict=True)
    ]
    names: list[str] = []
    for name in full:
        others = (name, *(f"{name}-{number}" for number in range(2, len(full) + 2)))
        names.append(next(one for one in others if one not in names and one != "developer"))
    return names


def _plain_name(program: Program) -> str:
    return LATE.sub(lambda match: match[2], _own_name(program))


def _own_name(program: Program) -> str:
    if isinstance(program, Launch):
        return Path(program.file).name.partition(".")[0]
    if isinstance(program, Node):
        return program.name or program.executable.rpartition("/")[2].removesuffix(".py")
    assert isinstance(program, Process)
    return program.name


def _group(made: list[Made], reader: LaunchReader, path: Path, origin: str, told: tuple[Diagnostic, ...]) -> Made:
    """All services of the launch file, to request them together."""
    names = [one.name for one in made]
    name = manifest_name(path.name.partition(".")[0])
    name = next(one for one in (name, f"{name}-all", *(f"{name}-{n}" for n in range(2, 1000))) if one not in names)
    own = {note for program in reader.programs for note in program.notes}
    notes = [d.message for d in told if d.severity == NOTE and d.message not in own]
    return Made("Group", name, {"services": names}, (f"{origin}.", *dict.fromkeys(notes)))
