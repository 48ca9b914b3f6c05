"""A launch file of ROS 1 as a Service, with one of its nodes as readiness. roslaunch goes on running it: what stands in
the file (parameters, remaps, respawning) stays there."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from rorg.importing.manifests import NOTE, Imported, Made
from rorg.manifest.yaml_text import Inline, Noted
from rorg.model.diagnostics import Diagnostic, Where

IMAGE = "ros:noetic-ros-base"
"""Where no other is named."""
DEEPEST = 20
"""Launch files that include each other."""
_ARGUMENT = re.compile(r"\$\((arg|find|env|optenv|dirname|anon|eval)\b([^()]*)\)")
Read = Callable[[Path], str | None]


@dataclass(frozen=True)
class Node:
    """One node that is started."""

    name: str
    """With its namespace: /camera/driver."""
    required: bool
    where: Where


@dataclass
class _Reading:
    """A launch file with all that it includes."""

    read: Read
    packages: Mapping[str, Path]
    """Folders of the packages that are known: that of the file itself."""
    nodes: list[Node] = field(default_factory=list)
    found: list[Diagnostic] = field(default_factory=list)

    def file(self, path: Path, arguments: Mapping[str, str], namespace: str, depth: int = 0) -> None:
        """All nodes of one file. `arguments`: those that it is given."""
        text = self.read(path)
        if text is None or depth > DEEPEST:
            why = "it cannot be read" if text is None else f"more than {DEEPEST} files include each other"
            self.found.append(
                Diagnostic(Where(str(path)), why, "a file that is there", "error" if depth == 0 else NOTE)
            )
            return
        try:
            top = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            line, column = error.position
            self.found.append(Diagnostic(Where(str(path), line, column + 1), f"not XML: {error}", "fixing it"))
            return
        if top.tag != "launch":
            self.found.append(Diagnostic(Where(str(path)), f"it begins with <{top.tag}>", "<launch>"))
            return
        self._below(top, path, dict(arguments), namespace, depth)

    def _below(self, top: ElementTree.Element, path: Path, given: dict[str, str], namespace: str, depth: int) -> None:
        values = dict(given)
        for element in top:
            if not self._holds(element, path, values):
                continue
            if element.tag == "arg":
                self._argument(element, path, values, given)
            elif element.tag == "group":
                inner = _joined(namespace, self._filled(element.get("ns", ""), path, values))
                self._below(element, path, values, inner, depth)
            elif element.tag == "node":
                self._node(element, path, values, namespace)
            elif element.tag == "include":
                self._include(element, path, values, namespace, depth)
            elif element.tag == "machine":
                self.found.append(_note(path, "<machine>: rorg starts nothing on other machines", "an rorg on each"))

    def _holds(self, element: ElementTree.Element, path: Path, values: Mapping[str, str]) -> bool:
        """By `if` and `unless`; what cannot be worked out here counts as true."""
        for word, wrong in (("if", ("false", "0")), ("unless", ("true", "1"))):
            if self._filled(element.get(word, ""), path, values).strip().lower() in wrong:
                return False
        return True

    def _argument(
        self, element: ElementTree.Element, path: Path, values: dict[str, str], given: Mapping[str, str]
    ) -> None:
        name = element.get("name", "")
        if element.get("value") is not None:
            values[name] = self._filled(element.get("value", ""), path, values)
        elif name not in given and element.get("default") is not None:
            values[name] = self._filled(element.get("default", ""), path, values)
        elif name not in values:
            message = f"the argument {name} has no value"
            self.found.append(Diagnostic(Where(str(path)), message, f"{name}:=VALUE behind the file"))

    def _node(self, element: ElementTree.Element, path: Path, values: Mapping[str, str], namespace: str) -> None:
        name = self._filled(element.get("name", ""), path, values)
        inner = _joined(namespace, self._filled(element.get("ns", ""), path, values))
        required = self._filled(element.get("required", ""), path, values).lower() in ("true", "1")
        if not name or "$(" in name + inner:
            self.found.append(_note(path, f"a node of {element.get('pkg')} whose name is made when it starts"))
        else:
            self.nodes.append(Node(_joined(inner, name), required, Where(str(path))))

    def _include(
        self, element: ElementTree.Element, path: Path, values: Mapping[str, str], namespace: str, depth: int
    ) -> None:
        file = self._filled(element.get("file", ""), path, values)
        passed = dict(values) if element.get("pass_all_args", "").lower() in ("true", "1") else {}
        for child in element:
            if child.tag == "arg" and self._holds(child, path, values):
                passed[child.get("name", "")] = self._filled(child.get("value", child.get("default", "")), path, values)
        inner = _joined(namespace, self._filled(element.get("ns", ""), path, values))
        if "$(" in file:
            self.found.append(_note(path, f"{file} is in another package: its nodes are not known here"))
        else:
            self.file(Path(file), passed, inner, depth + 1)

    def _filled(self, text: str, path: Path, values: Mapping[str, str]) -> str:
        """With $(arg NAME), $(find PACKAGE) of a known package and $(dirname) filled in; the rest as it is."""

        def fill(match: re.Match[str]) -> str:
            word, name = match[1], match[2].strip()
            if word == "arg":
                return values.get(name, match[0])
            if word == "find" and name in self.packages:
                return str(self.packages[name])
            return str(path.parent) if word == "dirname" else match[0]

        return _ARGUMENT.sub(fill, text)


def from_roslaunch(
    path: Path, read: Read, arguments: Mapping[str, str], image: str = "", with_master: bool = True
) -> Imported:
    """The Service of a launch file, and one for the ROS master where the tree has none yet (`with_master`)."""
    path = path.absolute()
    package = next((p for p in path.parents if read(p / "package.xml") is not None), None)
    name = _package_name(read(package / "package.xml") or "") if package else ""
    reading = _Reading(read, {name: package} if package and name else {})
    reading.file(path, arguments, "/")
    spec: dict[str, Any] = {"image": image or Noted(IMAGE, "your workspace's, with the packages of the file")}
    words = [f"{key}:={value}" for key, value in arguments.items()]
    spec["command"] = ["roslaunch", "--wait", *([name, path.name] if name else [str(path)]), *words]
    spec["profile"] = "ros1"
    if reading.nodes:
        first = next((n for n in reading.nodes if n.required), reading.nodes[-1])
        spec["ready"] = Inline({"ros_node": first.name, "timeout": "60s"})
    else:
        reading.found.append(_note(path, "no node is known, so it is ready when it runs", "a `ready` probe"))
    nodes = ", ".join(node.name for node in reading.nodes)
    comments = (
        f"From {path.name}{f' of the package {name}' if name else ''}.",
        *([f"Its nodes: {nodes}."] * bool(nodes)),
    )
    told = tuple(sorted(set(reading.found)))
    comments += tuple(d.message for d in told if d.severity == NOTE)
    made = [Made("Service", _service_name(path.stem), spec, comments)]
    if with_master:
        master = {"image": spec["image"], "command": ["roscore"], "profile": "common", "always_on": True}
        master |= {"ready": Inline({"tcp": 11311, "timeout": "30s"})}
        made.append(Made("Service", "roscore", master, ("The ROS master, which the profile ros1 needs.",)))
    return Imported(tuple(made), diagnostics=told)


def _package_name(text: str) -> str:
    found = re.search(r"<name>\s*([\w-]+)\s*</name>", text)
    return found[1] if found else ""


def _service_name(stem: str) -> str:
    """Of a file: what a manifest can be called."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", stem).strip("._-") or "launch"


def _joined(namespace: str, name: str) -> str:
    """A name in a namespace, as ROS resolves it."""
    if name.startswith("/"):
        return name
    return f"{namespace.rstrip('/')}/{name}" if name else namespace


def _note(path: Path, message: str, remedy: str = "") -> Diagnostic:
    return Diagnostic(Where(str(path)), message, remedy, NOTE)
