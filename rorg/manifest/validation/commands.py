"""Command lines: words that the engine, a shell or ROS reads differently from what was meant."""

from __future__ import annotations

import re
from collections.abc import Iterator

from rorg.manifest.validation.robot import Finding, each, in_containers
from rorg.manifest.validation.subject import BEFORE, SHELLS, Subject
from rorg.manifest.validation.texts import text_of

TRANSPARENT = frozenset(("ros_entrypoint.sh", "tini", "docker-init", "dumb-init", "env"))
"""Entry points that become the program in the words behind them."""
OFFICIAL = re.compile(r"(docker\.io/)?(library/|osrf/)?ros:")
KEYBOARD = frozenset(
    (
        *("teleop_twist_keyboard", "teleop_twist_keyboard.py", "turtle_teleop_key", "teleop_keyboard"),
        *("turtlebot3_teleop_key", "key_teleop", "key_teleop.py"),
    )
)
"""Programs that read single keys from a terminal, and end without one."""
PARAMETER = re.compile(r"_[A-Za-z]\w*:=.+")
"""A private parameter, as ROS 1 writes it."""
MODELS = re.compile(r"turtlebot3_(bringup|cartographer|description|fake_node|gazebo|navigation2?|node|slam)")
NUMBER = re.compile(r"(?<![\w.])[1-9][0-9]{3,4}(?![\w.])")
LOCAL = re.compile(r"(?:http://)?(?:(?:localhost|127\.0\.0\.1|\[::1\]):)?([0-9]{4,5})(?![0-9])")


def _in_one_word(subject: Subject) -> Iterator[Finding]:
    """Lists with a single text: the engine looks for a program with spaces in its name."""
    entry, command = tuple(subject.options.get("entrypoint") or ()), tuple(subject.options.get("command") or ())
    if len(entry) == 1 and " " in entry[0]:
        message = f"the engine looks for a program called '{entry[0]}'"
        yield Finding("command-in-one-word", subject.option("entrypoint"), message)
    transparent = entry and entry[-1].rpartition("/")[2] in TRANSPARENT
    if len(command) == 1 and " " in command[0] and (transparent or not entry):
        known = transparent or OFFICIAL.match(str(subject.options.get("image") or ""))
        unless = "" if known else ", unless the image's entry point splits it"
        message = f"the engine looks for a program called '{command[0]}'{unless}"
        yield Finding("command-in-one-word", subject.command(), message)


def _scripts(subject: Subject) -> Iterator[Finding]:
    """Scripts of a shell without quotes, and those for another shell."""
    words, script = subject.words, subject.script
    if not script:
        return
    at = words.index(script)
    if " " not in script and len(words) > at + 1 and "$" not in script:
        message = f"the shell runs only '{script}', and ignores the words behind it"
        yield Finding("script-not-quoted", subject.command(), message)
    if words[at - 2].rpartition("/")[2] not in ("sh", "dash") or "alpine" in str(subject.options.get("image")):
        return
    for first, file in (c[:2] for c in subject.commands if len(c) > 1):
        if "setup." in file and (first == "source" or (first == "." and file.endswith(".bash"))):
            what = "has no 'source'" if first == "source" else f"cannot read {file}"
            message = f"the sh of Debian and Ubuntu {what}: ROS is not set up"
            yield Finding("source-in-sh", subject.command(), message)


def _ros(subject: Subject) -> Iterator[Finding]:
    """Words for the other ROS, and parameters that a node does not read as such."""
    for words in subject.commands:
        names = [word.rpartition("/")[2] for word in words]
        file = next((word for word in words if word.endswith(".launch.py")), "")
        if file and "roslaunch" in names and "ros2" not in names:
            yield Finding("launch-file-of-ros2", subject.command(), f"roslaunch reads XML, and {file} is of ROS 2")
        if "ros2" in names and "run" in names and "--ros-args" not in words and (lost := _lost(words)):
            message = f"without --ros-args in front, '{lost}' sets no parameter, unless the program reads it itself"
            yield Finding("ros-args-missing", subject.command(), message)
        model = next((word for word in words if MODELS.fullmatch(word)), "")
        said = "TURTLEBOT3_MODEL" in subject.env or "TURTLEBOT3_MODEL" in subject.script
        if model and not said and not {"roslaunch", "launch"}.isdisjoint(names) and "model:=" not in " ".join(words):
            message = f"{model} ends without TURTLEBOT3_MODEL, unless the image sets it"
            yield Finding("turtlebot3-without-model", subject.command(), message)


def _lost(words: tuple[str, ...]) -> str:
    """The first parameter of a command without --ros-args."""
    for word, after in zip(words, (*words[1:], ""), strict=True):
        if word == "--params-file" or (word in ("-p", "--param") and ":=" in after):
            return f"{word} {after}"
        if PARAMETER.fullmatch(word) and not word.startswith("__"):
            return word
    return ""


def _terminals(subject: Subject) -> Iterator[Finding]:
    programs = KEYBOARD & subject.executables
    if programs and not subject.options.get("tty"):
        message = f"{min(programs)} reads keys from a terminal, and '{subject.name}' has none"
        yield Finding("keyboard-without-terminal", subject.command(), message)


def _shells(subject: Subject) -> Iterator[Finding]:
    """Shells without a script and without a terminal: they read the end of their input, and end."""
    options = subject.options
    if options.get("tty") or options.get("stdin_open") or "|" in subject.script:
        return
    last = [w for w in subject.commands[-1] if w.rpartition("/")[2] not in BEFORE | TRANSPARENT and w[0:1] != "-"]
    image = str(options.get("image") or "")
    if len(last) == 1 and last[0].rpartition("/")[2] in SHELLS:
        message = f"'{last[0]}' has no script and no terminal, and ends immediately"
        yield Finding("shell-without-terminal", subject.command(), message)
    elif not subject.words and OFFICIAL.match(image):
        message = f"the program of the official '{image}' is bash, which ends immediately without a terminal"
        yield Finding("shell-without-terminal", subject.at("image"), f"{message}, unless your image has another")


def _probes(subject: Subject) -> Iterator[Finding]:
    """Probes that never hold: of output that the engine does not keep, or at a port with its digits swapped."""
    silent = (subject.options.get("logging") or {}).get("driver") == "none"
    for asked in subject.asked:
        if asked.probe.kind == "log" and silent:
            message = f"'{subject.name}' is asked for a line of its output, and logging: none keeps no output"
            yield Finding("log-probe-without-log", subject.at(*asked.path), message)
        match = LOCAL.match(str(asked.probe.target)) if asked.probe.kind in ("tcp", "http") else None
        if match and (meant := _swapped(subject, match[1])):
            message = f"the probe asks port {match[1]}, and the command names port {meant}"
            yield Finding("probe-port-swapped", subject.at(*asked.path), message, meant)


def _swapped(subject: Subject, port: str) -> str:
    """The port of the command line that has the same digits in another order; empty if the port itself is named."""
    named = {number for word in subject.words for number in NUMBER.findall(word)}
    alike = [number for number in named if sorted(number) == sorted(port)]
    other = any(port in (p.host, p.port.partition("/")[0]) for _, p in subject.published)
    return alike[0] if len(alike) == 1 and port not in text_of(subject) and not other else ""


CHECKS = (
    *map(each, (_scripts, _ros, _probes)),
    *(in_containers(each(check)) for check in (_in_one_word, _terminals, _shells)),
)
