"""Imports a launch file of ROS 1 as a Service whose readiness is one of its nodes. roslaunch still runs the file, so
its parameters, remaps and respawning stay there."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rorg.manifest.files import Outside
from rorg.manifest.yaml_text import Inline, Noted
from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic, Where
from rorg.tools.importing.launch_packages import Package, Read
from rorg.tools.importing.launch_version import other_ros
from rorg.tools.importing.launch_xml import MOST_ELEMENTS, Element, read_launch
from rorg.tools.importing.manifests import NOTE, Imported, Made, manifest_name

IMAGE = "ros:noetic-ros-base"
"""Used if no other image is named."""
DEEPEST = 20
"""Levels of launch files that include each other."""
MOST_INCLUDES = 200
"""Included files, each counted as often as it is included."""
MOST_FILLED = 1 << 20
"""Characters that arguments add to a launch file and its includes."""
LONGEST = 1000
"""Characters of a name with its namespace."""
_ARGUMENT = re.compile(r"\$\((arg|find|env|optenv|dirname|anon|eval)\b([^()]*)\)")


@dataclass(frozen=True)
class Node:
    """One node that is started."""

    name: str
    """With its namespace: /camera/driver."""
    required: bool


@dataclass
class _Reading:
    """A launch file with everything that it includes. Raises TooMuch for more than anyone writes by hand."""

    read: Read
    packages: Mapping[str, Path]
    """Folders of the known packages: only that of the file itself."""
    nodes: list[Node] = field(default_factory=list)
    found: list[Diagnostic] = field(default_factory=list)
    files: dict[Path, Element | None] = field(default_factory=dict)
    includes: int = 0
    elements: int = 0
    filled: int = 0

    def file(self, path: Path, arguments: Mapping[str, str], namespace: str, by: Where, depth: int = 0) -> None:
        """Collects all nodes of a file. `arguments`: the arguments that it receives; `by`: the place of the include."""
        if depth > DEEPEST:
            message = f"{path}: more than {DEEPEST} files include each other"
            self.found.append(Diagnostic(by, message, "a shorter chain of includes", NOTE))
            return
        if path not in self.files:
            self.files[path] = self._top(path, by, depth)
        top = self.files[path]
        if top is not None:
            self._below(top, dict(arguments), namespace, depth)

    def _top(self, path: Path, by: Where, depth: int) -> Element | None:
        try:
            text = self.read(path)
        except OSError as error:
            remedy = f"--read {path}, if you trust it" if isinstance(error, Outside) else "an existing file"
            message = f"cannot read {path}: {error.strerror}"
            self.found.append(Diagnostic(by, message, remedy, NOTE if depth else "error"))
            return None
        top = read_launch(path, text)
        wrong = top if isinstance(top, Diagnostic) else other_ros(top, 1) if depth else None
        if isinstance(top, Diagnostic) or wrong:
            self.found += [wrong] if wrong else []
            return None
        return top

    def _below(self, top: Element, given: dict[str, str], namespace: str, depth: int) -> None:
        values = dict(given)
        for element in top.children:
            self.elements += 1
            if self.elements > MOST_ELEMENTS:
                message = f"more than {MOST_ELEMENTS} elements, each counted as often as it is included"
                raise TooMuch(element.where, message, "fewer includes")
            if not self._holds(element, values):
                continue
            if element.tag == "arg":
                self._argument(element, values, given)
            elif element.tag == "group":
                inner = self._inner(element, "ns", namespace, values)
                self._below(element, values, inner, depth)
            elif element.tag == "node":
                self._node(element, values, namespace)
            elif element.tag == "include":
                self._include(element, values, namespace, depth)
            elif element.tag == "machine":
                message = "<machine>: rorg starts nothing on other machines"
                self.found.append(_note(element.where, message, "to run rorg on each machine"))

    def _holds(self, element: Element, values: Mapping[str, str]) -> bool:
        """The value of `if` and `unless`; conditions that cannot be evaluated here count as true."""
        for word, wrong in (("if", ("false", "0")), ("unless", ("true", "1"))):
            if self._filled(element, word, values).strip().lower() in wrong:
                return False
        return True

    def _argument(self, element: Element, values: dict[str, str], given: Mapping[str, str]) -> None:
        name = element.get("name")
        if "value" in element.attributes:
            values[name] = self._filled(element, "value", values)
        elif name not in given and "default" in element.attributes:
            values[name] = self._filled(element, "default", values)
        elif name not in values:
            message = f"the argument {name} has no value"
            self.found.append(Diagnostic(element.where, message, f"{name}:=VALUE after the file"))

    def _node(self, element: Element, values: Mapping[str, str], namespace: str) -> None:
        name = element.get("name")
        inner = self._inner(element, "ns", namespace, values)
        required = self._filled(element, "required", values).lower() in ("true", "1")
        whole = self._inner(element, "name", inner, values)
        if not name or "$(" in whole:
            message = f"a node of {element.get('pkg')} gets its name only when it starts"
            self.found.append(_note(element.where, message))
        else:
            self.nodes.append(Node(whole, required))

    def _include(self, element: Element, values: Mapping[str, str], namespace: str, depth: int) -> None:
        self.includes += 1
        if self.includes > MOST_INCLUDES:
            message = f"more than {MOST_INCLUDES} includes, each counted as often as it is included"
            raise TooMuch(element.where, message, "fewer includes")
        file = self._filled(element, "file", values)
        passed = dict(values) if element.get("pass_all_args").lower() in ("true", "1") else {}
        for child in element.children:
            if child.tag == "arg" and self._holds(child, values):
                said = "value" if "value" in child.attributes else "default"
                passed[child.get("name")] = self._filled(child, said, values)
        inner = self._inner(element, "ns", namespace, values)
        if "$(" in file:
            self.found.append(_note(element.where, f"{file} is in another package, so its nodes are not known here"))
        else:
            self.file(Path(file), passed, inner, element.where, depth + 1)

    def _inner(self, element: Element, attribute: str, namespace: str, values: Mapping[str, str]) -> str:
        """A name or namespace inside another namespace."""
        full_name = _joined(namespace, self._filled(element, attribute, values))
        if len(full_name) > LONGEST:
            raise TooMuch(element.where, f"a name of more than {LONGEST} characters", "shorter names")
        return full_name

    def _filled(self, element: Element, attribute: str, values: Mapping[str, str]) -> str:
        """An attribute with $(arg NAME), $(find PACKAGE) of a known package, and $(dirname) filled in. Everything else
        stays as it is."""

        def fill(match: re.Match[str]) -> str:
            word, name, replacement = match[1], match[2].strip(), match[0]
            if word == "arg":
                replacement = values.get(name, replacement)
            elif word == "find" and name in self.packages:
                replacement = str(self.packages[name])
            elif word == "dirname":
                replacement = str(Path(element.where.file).parent)
            self.filled += len(replacement)
            if self.filled > MOST_FILLED:
                message = f"arguments add more than {MOST_FILLED >> 20} MiB"
                raise TooMuch(element.where, message, "shorter arguments")
            return replacement

        return _ARGUMENT.sub(fill, element.get(attribute))


def from_ros1(
    path: Path, package: Package, read: Read, arguments: Mapping[str, str], image: str, with_master: bool
) -> Imported:
    """The Service of a launch file, and one for the ROS master if the tree has none yet (`with_master`)."""
    name = package.name
    reading = _Reading(read, {name: package.folder} if package.folder and name else {})
    try:
        reading.file(path, arguments, "/", Where(str(path)))
    except TooMuch as bound:
        return Imported(diagnostics=tuple(sorted({*reading.found, bound.diagnostic})))
    spec: dict[str, Any] = {"image": image or Noted(IMAGE, "replace it by your workspace's image with these packages")}
    words = [f"{key}:={value}" for key, value in arguments.items()]
    spec["command"] = ["roslaunch", "--wait", *([name, path.name] if name else [str(path)]), *words]
    spec["profile"] = "ros1"
    if reading.nodes:
        first = next((n for n in reading.nodes if n.required), reading.nodes[-1])
        spec["ready"] = Inline({"ros_node": first.name, "timeout": "60s"})
    else:
        reading.found.append(
            _note(Where(str(path)), "no node is known, so the service is ready when it runs", "a `ready` probe")
        )
    nodes = ", ".join(node.name for node in reading.nodes)
    comments = (
        f"From {path.name}{f' of the package {name}' if name else ''}.",
        *([f"Its nodes: {nodes}."] * bool(nodes)),
    )
    told = tuple(sorted(set(reading.found)))
    comments += tuple(d.message for d in told if d.severity == NOTE)
    made = [Made("Service", manifest_name(path.stem), spec, comments)]
    if with_master:
        master = {"image": spec["image"], "command": ["roscore"], "profile": "common", "always_on": True}
        master |= {"ready": Inline({"tcp": 11311, "timeout": "30s"})}
        made.append(Made("Service", "roscore", master, ("The ROS master, which profile ros1 needs.",)))
    return Imported(tuple(made), diagnostics=told)


def _joined(namespace: str, name: str) -> str:
    """A name in a namespace, as ROS resolves it."""
    if name.startswith("/"):
        return name
    return f"{namespace.rstrip('/')}/{name}" if name else namespace


def _note(where: Where, message: str, remedy: str = "") -> Diagnostic:
    return Diagnostic(where, message, remedy, NOTE)
