"""Launch files that an import generates, for what no command line can say."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator, Mapping
from typing import Any
from xml.sax.saxutils import escape

from rorg.tools.importing.launch_programs import Component, Launch, Node, Program, Remaps
from rorg.tools.importing.launch_values import ParameterFile, Parameters, mapped
from rorg.tools.importing.launch_yaml import guess
from rorg.tools.importing.ros2_commands import value_text

_SEPARATORS = ",;|~^"


def needs_file(program: Program) -> bool:
    """Whether only a launch file can say it: components, transitions, or a scope around a whole launch file."""
    if isinstance(program, Node):
        return bool(program.components) or program.autostart
    scope = program.scope if isinstance(program, Launch) else None
    return bool(scope and (scope.namespace or scope.parameters or scope.remaps))


def launch_file(program: Program, comment: str) -> str:
    """A launch file that starts only this program."""
    if isinstance(program, Node):
        lines = _node(program)
    else:
        assert isinstance(program, Launch)
        lines = _launch(program)
    shown = re.sub("-{2,}", "-", comment)  # two would end the comment
    return "\n".join([f"<!-- {shown} -->", "<launch>", *(f"  {line}" for line in lines), "</launch>", ""])


def _tag(tag: str, attributes: Mapping[str, str], inner: Iterable[str] = ()) -> list[str]:
    """An element. Attributes are texts for `ros2 launch`; empty ones are left out."""
    said = "".join(f" {name}={_attribute(text)}" for name, text in attributes.items() if text)
    lines = [f"  {line}" for line in inner]
    return [f"<{tag}{said}>", *lines, f"</{tag}>"] if lines else [f"<{tag}{said}/>"]


def _attribute(text: str) -> str:
    return '"' + escape(text, {'"': "&quot;", "\n": "&#10;", "\t": "&#9;"}) + '"'


def _literal(text: str) -> str:
    """A text that `ros2 launch` takes as it is, except for what it finds out itself."""
    return mapped(text, _escaped, lambda match: match[0])


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace("$(", "\\$(")


def _words(words: Iterable[str]) -> str:
    """Words as one text, which `ros2 launch` splits again around its substitutions."""
    return " ".join(mapped(word, lambda text: _escaped(shlex.quote(text)), lambda match: match[0]) for word in words)


def _node(node: Node) -> list[str]:
    tag = "node_container" if node.components else "lifecycle_node" if node.autostart else "node"
    attributes = {
        **{"pkg": _literal(node.package), "exec": _literal(node.executable), "name": _literal(node.name)},
        **{"namespace": _literal(node.namespace), "args": _words(node.arguments)},
        **{"ros_args": _words(node.ros_arguments), "launch-prefix": _literal(node.prefix)},
        **{"autostart": "true" if node.autostart else "", "output": "screen"},
    }
    components = [line for one in node.components for line in _component(one)]
    return _tag(tag, attributes, [*_parameters(node.parameters), *_remaps("remap", node.remaps), *components])


def _component(one: Component) -> list[str]:
    attributes = {name: _literal(getattr(one, name)) for name in ("plugin", "name", "namespace")}
    extra = [_tag("extra_arg", {"name": _literal(name), "value": _literal(text)})[0] for name, text in one.extra]
    inner = [*_parameters(one.parameters), *_remaps("remap", one.remaps), *extra]
    return _tag("composable_node", {"pkg": _literal(one.package), **attributes}, inner)


def _remaps(tag: str, remaps: Remaps) -> Iterator[str]:
    for old, new in remaps:
        yield from _tag(tag, {"from": _literal(old), "to": _literal(new)})


def _parameters(parameters: Parameters) -> Iterator[str]:
    for one in parameters:
        if isinstance(one, ParameterFile):
            yield from _tag("param", {"from": _literal(one.path)})
        else:
            yield _tag("param", {"name": _literal(one.name)})[0].removesuffix("/>") + f"{_typed(one.value)}/>"


def _typed(value: Any) -> str:
    """The attributes of a value, so that ROS 2 reads the same type."""
    if isinstance(value, list):
        items = [_literal(item) if isinstance(item, str) else value_text(item) for item in value]
        sign = next((sign for sign in _SEPARATORS if not any(sign in item for item in items)), "\n")
        kind = f' type="list_of_{type(value[0]).__name__}"'
        return f" value={_attribute(sign.join(items))} value-sep={_attribute(sign)}{kind}"
    if isinstance(value, str):
        kind = "" if guess(value) == value and value else ' type="str"'
        return f" value={_attribute(_literal(value))}{kind}"
    return f" value={_attribute(value_text(value))}" + (' type="float"' if isinstance(value, float) else "")


def _launch(program: Launch) -> list[str]:
    scope = program.scope
    lines = _tag("push_ros_namespace", {"namespace": scope.namespace}) if scope.namespace else []
    for one in scope.parameters:
        if isinstance(one, ParameterFile):
            lines += _tag("set_parameters_from_file", {"filename": _literal(one.path)})
        else:
            lines += _tag("set_parameter", {"name": _literal(one.name), "value": _literal(value_text(one.value))})
    lines += _remaps("set_remap", scope.remaps)
    arguments = [
        f"<arg name={_attribute(_literal(name))} value={_attribute(_literal(value))}/>"
        for name, value in scope.variables.items()
    ]
    return lines + _tag("include", {"file": _literal(program.file)}, arguments)
