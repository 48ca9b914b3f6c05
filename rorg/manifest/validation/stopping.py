"""How services end: which process gets the signal, what it does then, and what restarts the service."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress

from rorg.manifest.dockerfile_lines import DockerfileError
from rorg.manifest.dockerfile_programs import Programs
from rorg.manifest.images import read_dockerfile
from rorg.manifest.validation.robot import Finding, Robot, each
from rorg.manifest.validation.subject import Subject
from rorg.manifest.validation.texts import text_of_dockerfile
from rorg.model.image_names import declared
from rorg.model.machines import ANYWHERE

ENGINE_RESTARTS = ("always", "unless-stopped", "on-failure")
CLEAN = re.compile(r"\.(py|sh|bash)$")
"""Programs that end cleanly on SIGTERM, and scripts of shells."""
INSTALLED = re.compile(r"/(devel|install|noetic|melodic|kinetic)/")
"""Where packages are installed; their nodes are below lib."""
EXEC = re.compile(r"(^|[;&|]\s*)exec\s")
NOTHING = re.compile(r"^(true|:|exit 0|exit|wait)$")
SHORT = 1.0
"""Seconds. No ROS node can unregister from its master in less."""


def _restarts(subject: Subject) -> Iterator[Finding]:
    if subject.service.machine == ANYWHERE:
        return  # the Swarm restarts its tasks by it
    policy = str(subject.options.get("restart") or "no")
    if policy.partition(":")[0] in ENGINE_RESTARTS:
        message = f"restart: {policy} lets the engine start what rorg has stopped, when the engine itself starts"
        yield Finding("engine-restart-policy", subject.option("restart"), message)


def _signals(subject: Subject) -> Iterator[Finding]:
    signal = str(subject.options.get("stop_signal") or "SIGTERM").upper().removeprefix("SIG")
    if signal in ("KILL", "9"):
        where = subject.option("stop_signal")
        yield Finding("stop-by-kill", where, f"'{subject.name}' is killed immediately instead of being stopped")
    elif signal in ("TERM", "15") and subject.ros1 and not subject.ros2 and (node := _node(subject)):
        end = "is killed after its grace period" if not subject.options.get("init") else "ends immediately"
        message = f"if {node} is a C++ node, it does not unregister on SIGTERM: it {end}, and stays registered"
        yield Finding("sigterm-with-cpp-node", subject.option("stop_signal"), message)
    grace = subject.options.get("stop_grace_period")
    if subject.ros1 and isinstance(grace, int | float) and grace < SHORT:
        message = f"{grace:g} s are too short for a node of ROS 1 to unregister"
        yield Finding("grace-too-short", subject.option("stop_grace_period"), message)


def _node(subject: Subject) -> str:
    """The node that gets the signal, if it may be written in C++: one of a ROS package. Shells, their scripts and
    unknown programs are not."""
    words = subject.words
    at = next((n for n, word in enumerate(words) if word.rpartition("/")[2] == "rosrun"), -1)
    named = words[at + 2 : at + 3] if at >= 0 else words[:1]
    first = named[0] if named and (at >= 0 or _of_a_package(named[0])) else ""
    return "" if not first or CLEAN.search(first) else f"'{first.rpartition('/')[2]}'"


def _of_a_package(path: str) -> bool:
    return "/lib/" in path and INSTALLED.search(path) is not None


def _shells(robot: Robot) -> Iterator[Finding]:
    """Shells that do not forward the signal. With an init that signals the whole group, all processes get it; then the
    remaining problem is that the shell's exit code hides that of its program."""
    for subject in (s for s in robot.subjects if s.script and s.service.restart != "never"):
        commands = [c for c in subject.commands if c]
        last = commands[-1] if commands else ()
        if len(commands) < 2 or last[0] == "exec":
            continue
        if NOTHING.match(" ".join(last)) and commands[-2][0] != "exec":
            message = f"the shell goes on after its program, with '{' '.join(last)}': its exit code is lost"
        elif not _group(subject) and not re.search(r"\b(done|fi|esac)$|trap ", subject.script.strip()):
            message = f"the shell keeps the signal from '{last[0]}': it is killed after its grace period"
        else:
            continue
        yield Finding("shell-without-exec", subject.command(), message)


def _group(subject: Subject) -> bool:
    """Whether an init sends the signal to the whole process group."""
    return bool(subject.options.get("init")) and subject.env.get("TINI_KILL_PROCESS_GROUP") == "1"


def _images(robot: Robot) -> Iterator[Finding]:
    """Images of the tree whose program is started by a shell, in services that declare no program."""
    for subject in robot.subjects:
        options = subject.options
        if _group(subject) or options.get("entrypoint") or subject.service.restart == "never":
            continue
        name = declared(str(options.get("image") or ""), robot.catalog.images)
        programs = _programs(robot, name) if name else Programs()
        program = programs.entrypoint if programs.entrypoint and programs.entrypoint.by_shell else programs.command
        if program is None or not program.by_shell or EXEC.search(program.text):
            continue
        if program.instruction == "ENTRYPOINT" or not options.get("command"):
            message = (
                f"'{name}' is started by a shell ({program.instruction} {program.text[:40]}), which keeps the signal "
            )
            yield Finding("shell-form-command", subject.at("image"), f"{message}from its program")


def _programs(robot: Robot, name: str) -> Programs:
    """The programs of an Image of the tree, by its Dockerfile and those of its bases."""
    programs, seen = Programs(), set[str]()
    while name and name not in seen:
        seen.add(name)
        image = robot.catalog.images[name]
        text = text_of_dockerfile(image)
        with suppress(DockerfileError):
            programs = programs.on(read_dockerfile(text, image).programs)
            name = declared(programs.base, robot.catalog.images)
    return programs


CHECKS = (_shells, _images, *map(each, (_restarts, _signals)))
