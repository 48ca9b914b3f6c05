"""Programs: images, commands, variables, probes, and how one service waits for another."""

from __future__ import annotations

import re
from collections.abc import Iterator

from rorg.manifest.validation.robot import Finding, Robot, each
from rorg.manifest.validation.subject import SHELLS, Subject
from rorg.model.diagnostics import HINT
from rorg.model.image_names import HUB, declared
from rorg.model.run_directory import RUN

ROS1_NAMES, ROS2_NAMES = (
    frozenset(("indigo", "kinetic", "lunar", "melodic", "noetic")),
    frozenset(("foxy", "galactic", "humble", "iron", "jazzy", "kilted", "rolling", "lyrical")),
)
CLI = ("rosnode", "rostopic", "rosservice", "rosparam", "ros2")
SECRET = re.compile(r"(PASSWORD|PASSWD|SECRET|API_?KEY|ACCESS_?KEY|AUTH_?TOKEN|_TOKEN)$", re.IGNORECASE)
PYTHON = re.compile(r"python[0-9.]*")
ASKS = r"\b(rostopic|rosnode|rosservice|rosparam|ros2|nc|curl|ping)\b"
OPERATORS = ("&&", "||", ";", "|", ">", ">>", "2>&1", "<", "&")
EXPANDED = re.compile(r"(?<!\$)\$(\(|\{?[A-Za-z_]\w*)|`")
"""Text that a shell expands."""
BEHIND = re.compile(r"(?<![&>|<])&(?![&>0-9])")
"""A program in the background of a shell."""
LOOP = (re.compile(r"\b(until|while)\b"), re.compile(ASKS), re.compile(r"\bsleep\b"))
"""Words of a waiting loop, in order."""


def _images(robot: Robot) -> Iterator[Finding]:
    """References that may mean another image tomorrow."""
    for subject in robot.subjects:
        name = str(subject.options.get("image") or "")
        if name.endswith(":latest") and not declared(name, robot.catalog.images):
            message = f"'{name}' is the image that was pushed last: the same manifests may run another image tomorrow"
            yield Finding("latest-tag", subject.at("image"), message)
    for name, image in sorted(robot.catalog.images.items()):
        for base in image.bases:
            if base.endswith(":latest") and not declared(base, robot.catalog.images):
                message = f"'{name}' is based on '{base}', which is the image that was pushed last"
                yield Finding("latest-tag", robot.sources["Image"][name].where("spec"), message)


def _distributions(subject: Subject) -> Iterator[Finding]:
    name = str(subject.options.get("image") or "")
    official = name.removeprefix(next((h for h in HUB if name.startswith(h)), "")).startswith(("ros:", "osrf/ros:"))
    if not official:
        return
    words = set(re.split(r"[:-]", name))
    first = subject.programs
    if words & ROS1_NAMES and "ros2" in first:
        yield Finding("ros-version-of-image", subject.at("image"), f"'{name}' is ROS 1, and has no ros2")
    elif words & ROS2_NAMES and {"roslaunch", "roscore", "rosrun"} & first:
        program = min({"roslaunch", "roscore", "rosrun"} & first)
        yield Finding("ros-version-of-image", subject.at("image"), f"'{name}' is ROS 2, and has no {program}")
    entry = subject.options.get("entrypoint")
    if entry and "ros_entrypoint.sh" not in " ".join(map(str, entry)) and not subject.script:
        message = f"the entry point of '{name}', which sets ROS up, is replaced by '{' '.join(map(str, entry))}'"
        yield Finding("ros-entrypoint-replaced", subject.option("entrypoint"), message)


def _probes(subject: Subject) -> Iterator[Finding]:
    """ROS programs as probes: each takes a second and a share of a CPU."""
    for asked in subject.asked:
        command = asked.probe.target
        program = _cli(" ".join(command)) if asked.probe.kind == "exec" and isinstance(command, tuple) else ""
        if program:
            message = f"{program} takes a second each time, and is asked every {asked.probe.interval:g} s"
            yield Finding("costly-probe", subject.at(*asked.path), message)
    check = subject.options.get("healthcheck") or {}
    test = check.get("test") or []
    program = _cli(" ".join(test))
    if program and not check.get("disable"):
        message = f"{program} takes a second each time, and the engine asks it all the time"
        yield Finding("costly-probe", subject.option("healthcheck", "test"), message)
    off = check.get("disable") or test == ["NONE"]
    for asked in (a for a in subject.asked_ready if off and a.probe.kind == "engine"):
        message = f"'{subject.name}' is ready by the engine's health check, which is disabled"
        yield Finding("ready-without-healthcheck", subject.at(*asked.path), message)


def _cli(text: str) -> str:
    words = {w.rpartition("/")[2] for w in re.split(r"[\s;&|]+", text)}
    return next((name for name in CLI if name in words), "")


def _loops(script: str) -> bool:
    """Whether a script polls and sleeps in a loop."""
    at = 0
    for word in LOOP:
        match = word.search(script, at)
        if match is None:
            return False
        at = match.end()
    return True


def _waiting(robot: Robot) -> Iterator[Finding]:
    """Services that guess how long another service takes, instead of checking it."""
    for subject in (s for s in robot.subjects if s.script):
        commands = [c for c in subject.commands if c]
        sleeps = next((c for c in commands[:-1] if c[0].rpartition("/")[2] == "sleep"), ())
        if _loops(subject.script):
            message = f"'{subject.name}' waits in a loop of its own for what it needs"
            yield Finding("sleep-as-readiness", subject.command(), message)
        elif sleeps and subject.ros and "while" not in subject.script:
            message = f"'{' '.join(sleeps)}' guesses how long something else takes"
            yield Finding("sleep-as-readiness", subject.command(), message)


def _daemons(subject: Subject) -> Iterator[Finding]:
    """The command ros2 starts a daemon, which stays and remembers nodes that are gone."""
    for command in subject.commands:
        words = [w.rpartition("/")[2] for w in command]
        asks = {"topic", "node", "service", "action", "param"} & set(words)
        if "ros2" in words and asks and "--no-daemon" not in words:
            message = "ros2 starts a daemon of its own in the container, which outlives the command"
            yield Finding("ros2-daemon", subject.command(), message)


def _variables(subject: Subject) -> Iterator[Finding]:
    for name, value in sorted(subject.env.items()):
        if SECRET.search(name) and value and name not in subject.service.secrets and "/" not in value:
            message = f"the value of {name} is in the manifest, and is shown with it"
            yield Finding("secret-in-manifest", subject.variable(name), message)
    words = subject.words
    first = words[0].rpartition("/")[2] if words else ""
    if PYTHON.fullmatch(first) and "PYTHONUNBUFFERED" not in subject.env and "-u" not in words[1:2]:
        message = f"'{subject.name}' buffers its output instead of writing each line"
        yield Finding("python-output-held-back", subject.command(), message)
    for value in subject.options.get("security_opt") or ():
        if str(value) in ("seccomp=unconfined", "seccomp:unconfined", "systempaths=unconfined"):
            message = f"{value} allows all kernel calls, also those that Docker refuses to containers"
            implied = HINT if subject.options.get("privileged") and value.startswith("seccomp") else ""
            yield Finding("unconfined", subject.item("security_opt", value), message, severity=implied)


def _requests(robot: Robot) -> Iterator[Finding]:
    """Requests that cannot keep anything active."""
    for source in robot.sources.get("Request", {}).values():
        for index, name in enumerate(source.spec.services):
            requester = source.spec.requester
            if requester in robot.catalog.members(name) and not robot.catalog.services[requester].meta:
                what = "itself" if name == requester else f"the group '{name}', of which it is one"
                message = f"'{requester}' requests {what}: that keeps nothing active"
                yield Finding("requests-itself", source.where("spec", "services", index), message)
    for subject in robot.subjects:
        for index, name in enumerate(subject.service.may_request):
            if name == subject.name:
                message = f"'{name}' may request itself: that keeps nothing active"
                yield Finding("requests-itself", subject.at("may_request", index), message)


def _shell_words(subject: Subject) -> Iterator[Finding]:
    words = tuple(word for word in subject.options.get("command") or () if not word.startswith(RUN))
    if not words or any(w.rpartition("/")[2] in SHELLS for w in subject.words):
        return
    word = _for_a_shell(words)
    if word:
        message = f"no shell runs this command, and '{word}' is handed to the program as it is"
        yield Finding("shell-words-without-shell", subject.command(), message)
    elif "sudo" in words and "no-new-privileges:true" in (subject.options.get("security_opt") or ()):
        yield Finding("sudo-without-privileges", subject.command(), "sudo gains nothing under no-new-privileges")


def _for_a_shell(words: tuple[str, ...]) -> str:
    """The first word that only a shell understands. The text behind `-c` and similar options is for another program."""
    if words[0] in ("source", "."):
        return words[0]
    operator = next((w for w in words if w in OPERATORS), "")
    if operator:
        return operator
    text = next((n for n, w in enumerate(words) if w in ("-c", "-e", "--eval")), len(words))
    return next((w for w in words[:text] if EXPANDED.search(w)), "")


def _beside(robot: Robot) -> Iterator[Finding]:
    """Programs in the background, whose end nothing notices."""
    for subject in (s for s in robot.subjects if s.script and s.service.restart != "never"):
        text = re.sub(r"'[^']*'|\"[^\"]*\"", "", subject.script)
        if BEHIND.search(text.rstrip()) and not re.search(r"\bwait -n\b|\btrap\b", text):
            message = f"'{subject.name}' begins a program in the background: nothing notices how it ends"
            yield Finding("program-in-background", subject.command(), message)


CHECKS = (
    _beside,
    _images,
    _waiting,
    _requests,
    *map(each, (_shell_words, _distributions, _probes, _daemons, _variables)),
)
