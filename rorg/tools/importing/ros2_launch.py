"""Reads launch files of ROS 2 in XML and YAML: everything that they start, in the order in which they say it.

What a group sets ends with it. What an included file sets stays, as in `ros2 launch`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from rorg.manifest.files import Outside
from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic, Where
from rorg.tools.importing.launch_nodes import NodeReader
from rorg.tools.importing.launch_programs import Component, Node, Program, joined
from rorg.tools.importing.launch_values import Filler, ParameterFile, Scope, Setting, truth
from rorg.tools.importing.launch_version import other_ros
from rorg.tools.importing.launch_words import Missing, Refusal
from rorg.tools.importing.launch_xml import MOST_ELEMENTS, Element, read_launch
from rorg.tools.importing.launch_yaml import guess, read_yaml_launch
from rorg.tools.importing.manifests import NOTE

DEEPEST = 20
"""Levels of launch files that include each other."""
MOST_INCLUDES = 200
"""Included files, each counted as often as it is included."""
MOST_PROGRAMS = 500
"""A robot's launch files start some dozens."""
NODES = ("node", "lifecycle_node", "node_container")
NOTHING = {"log", "log_info", "set_ros_log_dir"}
"""Actions that start nothing and change no program."""


@dataclass
class LaunchReader:
    """A launch file with everything that it includes. Raises TooMuch for more than anyone writes by hand."""

    filler: Filler
    skip: bool = False
    """Leave out what cannot be carried over."""
    programs: list[Program] = field(default_factory=list)
    found: list[Diagnostic] = field(default_factory=list)
    tops: dict[Path, Element | Diagnostic] = field(default_factory=dict)
    loads: list[tuple[Element, str, tuple[Component, ...]]] = field(default_factory=list)
    """Components to load into a container: place, full name of the container."""
    includes: int = 0
    elements: int = 0
    fatal: bool = False
    """Whether there are errors that leaving out would not solve."""

    def __post_init__(self) -> None:
        self.nodes = NodeReader(self.filler, self.found)

    def file(self, path: Path, scope: Scope, by: Where, depth: int = 0) -> None:
        """Reads all actions of a file. `by`: the place of the include."""
        if depth > DEEPEST:
            message = f"{path.name}: more than {DEEPEST} files include each other"
            raise TooMuch(by, message, "a shorter chain of includes")
        if path not in self.tops:
            self.tops[path] = self._top(path, by, depth)
        top = self.tops[path]
        if isinstance(top, Diagnostic):
            self.found.append(top)
            self.fatal = True
        else:
            self._actions(top, scope, depth)

    def _top(self, path: Path, by: Where, depth: int) -> Element | Diagnostic:
        try:
            text = self.filler.packages.read(path)
        except OSError as error:
            remedy = f"--read {path}, if you trust it" if isinstance(error, Outside) else "an existing file"
            return Diagnostic(by, f"cannot read {path}: {error.strerror}", remedy)
        top = (read_yaml_launch if path.suffix in (".yaml", ".yml") else read_launch)(path, text)
        return top if isinstance(top, Diagnostic) else (depth and other_ros(top, 2)) or top

    def _actions(self, parent: Element, scope: Scope, depth: int) -> None:
        for element in parent.children:
            self.elements += 1
            if self.elements > MOST_ELEMENTS:
                message = f"more than {MOST_ELEMENTS} elements, each counted as often as it is included"
                raise TooMuch(element.where, message, "fewer includes")
            try:
                if self.nodes.holds(element, scope):
                    self._action(element, scope, depth)
            except Refusal as refusal:
                self._refused(element.where, refusal)

    def _refused(self, where: Where, refusal: Refusal) -> None:
        """Reports an element that cannot be carried over: an error, or a warning if such elements are left out."""
        if self.skip and not isinstance(refusal, Missing):
            self.found.append(Diagnostic(where, f"skipped: {refusal.message}", refusal.remedy, "warning"))
            return
        self.fatal |= isinstance(refusal, Missing)
        self.found.append(Diagnostic(where, refusal.message, refusal.remedy))

    def _action(self, element: Element, scope: Scope, depth: int) -> None:
        tag = element.tag.replace("-", "_")
        if tag in NODES:
            self._add(self.nodes.node(element, scope))
        elif tag == "executable":
            self._add(self.nodes.process(element, scope))
        elif tag == "load_composable_node":
            self._load(element, scope)
        elif tag == "group":
            self._group(element, scope, depth)
        elif tag == "include":
            self._include(element, scope, depth)
        elif tag in ("timer", "ros_timer"):
            period = self.nodes.fill(element, "period", scope)
            self._note(element, f"the {period} s of <{tag}> are not carried over", "`needs` and `ready`")
            self._actions(element, scope, depth)
        elif tag in NOTHING:
            self._note(element, f"<{tag}> is not carried over")
        elif tag in _SETTERS:
            _SETTERS[tag](self.nodes, element, scope)
        else:
            raise Refusal(f"<{element.tag}> cannot be carried over", "a Service that runs `ros2 launch` with the file")

    def _add(self, program: Program) -> None:
        self.programs.append(program)
        if len(self.programs) > MOST_PROGRAMS:
            raise TooMuch(program.where, f"more than {MOST_PROGRAMS} programs", "several launch files")

    def _note(self, element: Element, message: str, remedy: str = "") -> None:
        self.found.append(Diagnostic(element.where, message, remedy, NOTE))

    def _load(self, element: Element, scope: Scope) -> None:
        self.nodes.noted(element)
        target = joined("/", self.nodes.required(element, "target", scope))
        parts = [child for child in element.children if self.nodes.holds(child, scope)]
        self.loads.append((element, target, tuple(self.nodes.component(child, scope) for child in parts)))

    def _group(self, element: Element, scope: Scope, depth: int) -> None:
        kept = {
            self.nodes.required(child, "name", scope): self.nodes.fill(child, "value", scope)
            for child in element.children
            if child.tag == "keep"
        }
        scoped = truth(self.nodes.fill(element, "scoped", scope) or "true")
        forwarding = truth(self.nodes.fill(element, "forwarding", scope) or "true")
        inner = scope
        if scoped:
            inner = scope.copy() if forwarding else Scope()
        inner.variables |= kept
        self._actions(_without_keeps(element), inner, depth)

    def _include(self, element: Element, scope: Scope, depth: int) -> None:
        self.includes += 1
        if self.includes > MOST_INCLUDES:
            message = f"more than {MOST_INCLUDES} includes, each counted as often as it is included"
            raise TooMuch(element.where, message, "fewer includes")
        file = self.nodes.required(element, "file", scope)
        passed = {}
        for child in element.children:
            if child.tag not in ("arg", "let"):
                raise Refusal(f"<{child.tag}> is no part of <include>", "to drop it")
            passed[self.nodes.required(child, "name", scope)] = self.nodes.fill(child, "value", scope)
        scope.variables |= passed
        here = self.filler.packages.here(file)
        if here is not None and not here.is_absolute():
            raise Refusal(f"{file} is relative to where `ros2 launch` starts", f"$(dirname)/{file}")
        if here is None or here.suffix == ".py":
            self._whole(element, scope, file, here)
        else:
            self.file(Path(os.path.normpath(here)), scope, element.where, depth + 1)

    def _whole(self, element: Element, scope: Scope, file: str, here: Path | None) -> None:
        try:
            if here is not None:
                self.filler.packages.read(here)
        except FileNotFoundError as error:
            raise Missing(f"cannot read {here}: {error.strerror}", "an existing file") from error
        except OSError:
            pass  # it is there; nothing of it is needed here
        why = "is written in Python" if file.endswith(".py") else "is in another package"
        message = f"{file} {why}, so it becomes one service that runs `ros2 launch`"
        self._note(element, message)
        self.filler.spend(scope.size + sum(map(len, scope.variables.values())), element.where)
        self._add(replace(self.nodes.launch(element, scope, file), notes=(message,)))

    def finish(self) -> None:
        """Puts components into the containers that load them."""
        for element, target, components in self.loads:
            at = [i for i, p in enumerate(self.programs) if isinstance(p, Node) and p.full_name == target]
            if not at:
                message = f"no node_container {target} is in this file or its includes, to load components into"
                self._refused(element.where, Refusal(message, "the launch file that starts it and includes this one"))
                continue
            container = self.programs[at[0]]
            assert isinstance(container, Node)
            self.programs[at[0]] = replace(container, components=(*container.components, *components))


def _without_keeps(element: Element) -> Element:
    """A group without the parts that are no actions."""
    children = [child for child in element.children if child.tag != "keep"]
    return Element(element.tag, element.attributes, element.where, children)


def _arg(nodes: NodeReader, element: Element, scope: Scope) -> None:
    name = nodes.required(element, "name", scope)
    if name not in scope.variables:
        if "default" not in element.attributes:
            raise Missing(f"the argument {name} has no value", f"{name}:=VALUE after the file")
        scope.variables[name] = nodes.fill(element, "default", scope)
    choices = [nodes.fill(child, "value", scope) for child in element.children if child.tag == "choice"]
    if choices and scope.variables[name] not in choices:
        raise Refusal(f"'{scope.variables[name][:60]}' is no choice for {name}", f"one of {', '.join(choices)}")


def _let(nodes: NodeReader, element: Element, scope: Scope) -> None:
    scope.variables[nodes.required(element, "name", scope)] = nodes.fill(element, "value", scope)


def _set_env(nodes: NodeReader, element: Element, scope: Scope) -> None:
    scope.environment[nodes.variable(element, scope)] = nodes.fill(element, "value", scope)


def _unset_env(nodes: NodeReader, element: Element, scope: Scope) -> None:
    name = nodes.variable(element, scope)
    if scope.environment.pop(name, None) is None:
        raise Refusal(f"{name} is not set in this file, so a container cannot be without it", "to drop it")


def _push_namespace(nodes: NodeReader, element: Element, scope: Scope) -> None:
    scope.namespace = nodes.namespace(element, scope)


def _set_remap(nodes: NodeReader, element: Element, scope: Scope) -> None:
    scope.remaps += ((nodes.required(element, "from", scope), nodes.required(element, "to", scope)),)


def _set_parameter(nodes: NodeReader, element: Element, scope: Scope) -> None:
    _set(nodes, element, scope, nodes.required(element, "name", scope))


def _parameters_file(nodes: NodeReader, element: Element, scope: Scope) -> None:
    scope.parameters += (ParameterFile(nodes.required(element, "filename", scope)),)


def _use_sim_time(nodes: NodeReader, element: Element, scope: Scope) -> None:
    _set(nodes, element, scope, "use_sim_time")


def _set(nodes: NodeReader, element: Element, scope: Scope, name: str) -> None:
    """Sets a parameter of all nodes. Its value is a text, also in YAML, and has the type that it looks like."""
    scope.parameters += (Setting(name, guess(nodes.required(element, "value", scope))),)


_SETTERS: Mapping[str, Callable[[NodeReader, Element, Scope], None]] = {
    "arg": _arg,
    "let": _let,
    "set_env": _set_env,
    "unset_env": _unset_env,
    "push_ros_namespace": _push_namespace,
    "set_remap": _set_remap,
    "set_parameter": _set_parameter,
    "set_parameters_from_file": _parameters_file,
    "set_use_sim_time": _use_sim_time,
}
"""Action -> what it sets for the actions after it."""
