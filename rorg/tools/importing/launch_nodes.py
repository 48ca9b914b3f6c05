"""Reads the programs of ROS 2 launch files: nodes, containers with their components, and other executables."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic
from rorg.tools.importing.launch_programs import Component, Launch, Node, Process, Remaps, joined
from rorg.tools.importing.launch_values import Filler, ParameterFile, Parameters, Scope, Setting, truth
from rorg.tools.importing.launch_words import Refusal
from rorg.tools.importing.launch_xml import Element
from rorg.tools.importing.launch_yaml import TYPES, guess, uniform
from rorg.tools.importing.manifests import NOTE

LONGEST = 1000
"""Characters of a name with its namespace."""
_VARIABLE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_PROGRAM = {"if", "unless", "name", "output", "cwd", "respawn", "launch-prefix", "env", "exec_name", "log_cmd"}
CARRIED = {
    "node": {*_PROGRAM, "pkg", "exec", "namespace", "args", "ros_args", "param", "remap"},
    "executable": {*_PROGRAM, "cmd", "shell"},
    "composable_node": {"if", "unless", "pkg", "plugin", "name", "namespace", "param", "remap", "extra_arg"},
    "load_composable_node": {"if", "unless", "target", "composable_node"},
}
CARRIED["node_container"] = CARRIED["node"] | {"composable_node"}
CARRIED["lifecycle_node"] = CARRIED["node"] | {"autostart"}
"""Attributes and children that have a meaning for rorg, or none that anyone misses."""
REMEDIES = {
    "respawn_delay": "to leave it out: delays grow automatically",
    "respawn_max_retries": "to leave it out: delays grow automatically",
    "emulate_tty": "container: {tty: true}",
    "sigterm_timeout": "container: {stop_grace_period: 10s}",
    "sigkill_timeout": "container: {stop_grace_period: 10s}",
    "on_exit": "to leave it out: rorg restarts a program that ends",
}


@dataclass
class NodeReader:
    """Reads programs. Raises Refusal."""

    filler: Filler
    found: list[Diagnostic]

    def fill(self, element: Element, attribute: str, scope: Scope) -> str:
        """An attribute with its substitutions filled in."""
        return self.filler.fill(element.get(attribute), scope, element.where)

    def required(self, element: Element, attribute: str, scope: Scope) -> str:
        """An attribute that must not be empty."""
        value = self.fill(element, attribute, scope)
        if not value:
            raise Refusal(f"<{element.tag}> has no `{attribute}`", f"{attribute}=...")
        return value

    def variable(self, element: Element, scope: Scope) -> str:
        """The name of a variable of the environment."""
        name = self.required(element, "name", scope)
        if not _VARIABLE.fullmatch(name):
            raise Refusal(f"'{name[:60]}' is not a name of an environment variable", "letters, digits and _")
        return name

    def holds(self, element: Element, scope: Scope) -> bool:
        """The value of `if` and `unless`."""
        if "if" in element.attributes and not truth(self.fill(element, "if", scope)):
            return False
        return "unless" not in element.attributes or not truth(self.fill(element, "unless", scope))

    def node(self, element: Element, scope: Scope) -> Node:
        """A node, a lifecycle node, or a container with the components that it names."""
        parts = [child for child in element.children if child.tag == "composable_node"]
        components = tuple(self.component(child, scope) for child in parts if self.holds(child, scope))
        parameters = (*scope.parameters, *self._parameters(element, scope))
        program = self._program(element, scope)
        if not components and (file := _between(parameters)):
            message = f"if {file} names this node, its values win over those that the launch file sets"
            self.found.append(Diagnostic(element.where, message, severity=NOTE))
            program["notes"] += (message,)
        return Node(
            package=self.fill(element, "pkg", scope),
            executable=self.required(element, "exec", scope),
            namespace=self.namespace(element, scope),
            arguments=self.filler.words(element.get("args"), scope, element.where),
            ros_arguments=self.filler.words(element.get("ros_args"), scope, element.where),
            parameters=parameters,
            remaps=(*scope.remaps, *self._remaps(element, scope)),
            prefix=self.fill(element, "launch-prefix", scope),
            components=components,
            autostart=element.tag == "lifecycle_node" and truth(self.fill(element, "autostart", scope) or "false"),
            **program,
        )

    def component(self, element: Element, scope: Scope) -> Component:
        """A node that a container loads."""
        self.noted(element)
        self.filler.spend(scope.size, element.where)
        extra = (
            (self.required(child, "name", scope), self.required(child, "value", scope))
            for child in element.children
            if child.tag == "extra_arg"
        )
        return Component(
            package=self.required(element, "pkg", scope),
            plugin=self.required(element, "plugin", scope),
            name=self.fill(element, "name", scope),
            namespace=self.namespace(element, scope),
            parameters=(*scope.parameters, *self._parameters(element, scope)),
            remaps=(*scope.remaps, *self._remaps(element, scope)),
            extra=tuple(extra),
        )

    def process(self, element: Element, scope: Scope) -> Process:
        """Another executable."""
        line = element.get("cmd")
        if truth(self.fill(element, "shell", scope) or "false"):
            words: tuple[str, ...] = ("sh", "-c", self.filler.fill(line, scope, element.where))
        else:
            words = self.filler.words(line, scope, element.where)
        prefix = self.filler.words(element.get("launch-prefix"), scope, element.where)
        if not words:
            raise Refusal(f"<{element.tag}> has no `cmd`", "cmd=...")
        fallback = (line.split() or words)[0]
        return Process(words=(*prefix, *words), **self._program(element, scope, fallback))

    def launch(self, element: Element, scope: Scope, file: str) -> Launch:
        """An included file that runs as a whole."""
        return Launch(where=element.where, file=file, scope=scope.copy(), environment=dict(scope.environment))

    def _program(self, element: Element, scope: Scope, fallback: str = "") -> dict[str, Any]:
        """The fields of any program."""
        self.filler.spend(scope.size, element.where)
        environment = dict(scope.environment)
        for child in element.children:
            if child.tag == "env":
                environment[self.variable(child, scope)] = self.fill(child, "value", scope)
        directory = self.fill(element, "cwd", scope)
        directory = directory if directory.startswith("/") else ""
        return {
            "where": element.where,
            "name": self.fill(element, "name", scope) or fallback.rpartition("/")[2],
            "environment": environment,
            "directory": directory,
            "respawn": truth(self.fill(element, "respawn", scope) or "false"),
            "notes": self.noted(element, () if directory else ("cwd",)),
        }

    def noted(self, element: Element, lost: Sequence[str] = ()) -> tuple[str, ...]:
        """Notes what is not carried over. `lost`: attributes that usually are."""
        carried, notes = CARRIED[element.tag], []
        for child in element.children:
            if child.tag not in carried:
                raise Refusal(f"<{child.tag}> is no part of <{element.tag}>", "to drop it")
        for name in element.attributes:
            if name not in carried or name in lost:
                notes.append(f"{name} of <{element.tag}> is not carried over")
                self.found.append(Diagnostic(element.where, notes[-1], REMEDIES.get(name, ""), NOTE))
        return tuple(notes)

    def namespace(self, element: Element, scope: Scope) -> str:
        """The namespace of an element, absolute; empty if nothing says one."""
        whole = joined(scope.namespace, self.fill(element, "namespace", scope))
        if len(whole) > LONGEST:
            raise TooMuch(element.where, f"a name of more than {LONGEST} characters", "shorter names")
        return whole

    def _remaps(self, element: Element, scope: Scope) -> Remaps:
        remaps = [child for child in element.children if child.tag == "remap"]
        return tuple((self.required(one, "from", scope), self.required(one, "to", scope)) for one in remaps)

    def _parameters(self, element: Element, scope: Scope) -> Iterator[Setting | ParameterFile]:
        for child in element.children:
            if child.tag != "param":
                continue
            if "from" in child.attributes:
                yield self._file(child, scope)
            else:
                yield from self._settings(child, scope, "")

    def _file(self, element: Element, scope: Scope) -> ParameterFile:
        path = self.required(element, "from", scope)
        if truth(self.fill(element, "allow_substs", scope) or "false") and self._has_substitutions(path):
            message = f"rorg passes {path} as it is, without filling in substitutions such as $(var x)"
            self.found.append(Diagnostic(element.where, message, "a file with the values", "warning"))
        return ParameterFile(path)

    def _has_substitutions(self, path: str) -> bool:
        """Whether a parameter file has substitutions; true if it cannot be read here."""
        here = self.filler.packages.here(path)
        try:
            return here is None or "$(" in self.filler.packages.read(here)
        except OSError:
            return True

    def _settings(self, element: Element, scope: Scope, above: str) -> Iterator[Setting]:
        """The values of a parameter, which may have parameters inside."""
        name = above + self.required(element, "name", scope)
        inner = [child for child in element.children if child.tag == "param"]
        if bool(inner) == ("value" in element.attributes):
            raise Refusal(f"the parameter {name} has neither a value nor parameters inside, or both", "value=...")
        if not inner:
            yield self._setting(element, scope, name)
        for child in inner:
            yield from self._settings(child, scope, f"{name}.")

    def _setting(self, element: Element, scope: Scope, name: str) -> Setting:
        """A parameter with its value, in the type that ROS 2 gives it."""
        value = self._value(element, scope)
        kind = element.get("type").removeprefix("list_of_")
        if kind:
            items = value if isinstance(value, list) else [value]
            if kind == "str":
                items = [self.fill(element, "value", scope)] if not isinstance(value, list) else [*map(str, items)]
            elif kind == "float":
                items = [_float(item) for item in items]
            if kind not in TYPES or not all(type(item) is TYPES[kind] for item in items):
                raise Refusal(f"the parameter {name} is not of type {element.get('type')}", "another type")
            value = items if isinstance(value, list) and element.get("type") != "str" else items[0]
        if isinstance(value, list) and not uniform(value):
            raise Refusal(f"the parameter {name} is a list of nothing, or of several types", "items of one type")
        return Setting(name, uniform(value) if isinstance(value, list) else value)

    def _value(self, element: Element, scope: Scope) -> Any:
        """The value as it is written: typed by YAML, or what its text looks like."""
        if "value" in element.literals:
            literal = element.literals["value"]
            items = literal if isinstance(literal, list) else [literal]
            filled = [self.filler.fill(i, scope, element.where) if isinstance(i, str) else i for i in items]
            return filled if isinstance(literal, list) else filled[0]
        separator = element.get("value-sep")
        text = self.fill(element, "value", scope)
        return [guess(item) for item in text.split(separator)] if separator else guess(text)


def _float(item: Any) -> Any:
    """A number as floating point; anything else unchanged."""
    try:
        return item if isinstance(item, bool) else float(item)
    except (TypeError, ValueError, OverflowError):
        return item


def _between(parameters: Parameters) -> str:
    """A parameter file between two values: ROS 2 joins all values of a command line, at the place of the first."""
    settings, file = False, ""
    for one in parameters:
        if isinstance(one, ParameterFile):
            file = one.path if settings else ""
        elif file:
            return file
        else:
            settings = True
    return ""
