"""Adds what a project leaves out: environments from env files and from outside, the default network, the engine's names
of networks and volumes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rorg.model.diagnostics import Where
from rorg.tools.compose.assemble import RESOURCES, Assembler
from rorg.tools.compose.nodes import Node
from rorg.tools.compose.project import VALUE, Place, Project
from rorg.tools.compose.variables import Variables, bare, read_env_file


def normalised(
    tree: Node, name: str, directory: Path, assembler: Assembler, variables: Variables, profiles: Sequence[str]
) -> Project:
    """The project from a tree of canonical forms."""
    sections = {key: dict(tree.get(key).mapping) for key in RESOURCES}
    services = {key: _service(node, assembler, variables) for key, node in sections["services"].items()}
    sections["services"] = services
    if any("default" in node.get("networks").mapping for node in services.values()):
        sections["networks"].setdefault("default", Node({}, tree.where))
    for kind in ("networks", "volumes", "configs", "secrets"):
        sections[kind] = {key: _named(key, node, name) for key, node in sections[kind].items() if not _extension(key)}
    for kind in ("configs", "secrets"):
        sections[kind] = {key: _from_outside(node, variables) for key, node in sections[kind].items()}
    sections["models"] = tree.get("models").mapping
    places: dict[Place, Where] = {}
    taken: dict[Place, tuple[str, ...]] = {}
    for kind, entries in sections.items():
        for key, node in entries.items():
            _walk((kind, key), node, places, taken)
    of = {key: _profiles(node) for key, node in services.items()}
    plain: dict[str, Any] = {
        kind: {key: node.plain() for key, node in entries.items()} for kind, entries in sections.items()
    }
    project = Project(
        name,
        directory,
        **plain,
        extensions={key: node.plain() for key, node in tree.mapping.items() if _extension(key)},
        enabled=frozenset(key for key in services if not of[key] or "*" in profiles or set(of[key]) & set(profiles)),
        profiles={key: names for key, names in of.items() if names},
        places=places,
        taken=taken,
    )
    asked = {name for names in taken.values() for name in names}
    known = {name: variable for name, variable in variables.asked.items() if name in asked}
    return replace(project, variables=known, files=tuple(assembler.paths))


def _extension(key: str) -> bool:
    return key.startswith("x-")


def _profiles(node: Node) -> tuple[str, ...]:
    return tuple(one.value for one in node.get("profiles").items)


def _walk(path: Place, node: Node, places: dict[Place, Where], taken: dict[Place, tuple[str, ...]]) -> None:
    if node.place.line:
        places[path] = node.place
    if node.taken:
        taken[path] = node.taken
    inner: Iterator[tuple[str | int, Node]] = iter(node.mapping.items()) if node.mapping else enumerate(node.items)
    for key, value in inner:
        _walk((*path, key), value, places, taken)


def _named(key: str, node: Node, project: str) -> Node:
    """A node with the engine's name, which starts with the project's name unless it is external."""
    if "name" in node.mapping:
        return node
    outside = "external" in node.mapping
    return node.but({"name": Node(key if outside else f"{project}_{key}", node.where), **node.mapping})


def _from_outside(node: Node, variables: Variables) -> Node:
    """A config or secret; the variable that it takes its content from counts as used."""
    said = node.get("environment")
    if not isinstance(said.value, str):
        return node
    value = node.mapping.get(VALUE) or said.but(variables.take(said.value, said.where))
    return node.having(environment=said.but(said.value, taken=(said.value,)), **{VALUE: value})


def _service(node: Node, assembler: Assembler, variables: Variables) -> Node:
    """A complete service. An empty text, often of a variable that is not set, means the same as no key."""
    entries = {key: one for key, one in node.mapping.items() if one.value not in (None, "") or _extension(key)}
    if {"environment", "env_file"} & entries.keys():
        entries["environment"] = _environment(node, assembler, variables)
    if "label_file" in entries:
        entries["labels"] = _labels(node, assembler, variables)
    if "secrets" in entries:
        entries["secrets"] = entries["secrets"].but([_mounted(one) for one in entries["secrets"].items])
    if "build" in entries:
        entries["build"] = _build(entries["build"], variables)
    if not node.get("networks").mapping and "network_mode" not in entries and "provider" not in entries:
        entries["networks"] = Node({"default": Node({}, node.where)}, node.where)
    made = node.but(entries)
    _count_copies(made, assembler)
    return made


def _count_copies(service: Node, assembler: Assembler) -> None:
    """Counts each further copy of a service as a service of its own."""
    said = service.mapping.get("scale") or service.get("deploy", "replicas")
    if isinstance(said.value, int) and said.value > 1:
        assembler.files.spend((said.value - 1) * service.size(), said.where)


def _mounted(secret: Node) -> Node:
    """A secret without a target is mounted in /run/secrets."""
    source = secret.get("source")
    if source.value is None or "target" in secret.mapping:
        return secret
    return secret.having(target=source.but(f"/run/secrets/{source.value}"))


def _build(build: Node, variables: Variables) -> Node:
    if not {"dockerfile", "dockerfile_inline"} & build.mapping.keys():
        build = build.having(dockerfile=Node("Dockerfile", build.where))
    args = {key: bare(key, one, variables) for key, one in build.get("args").mapping.items()}
    return build.having(args=build.get("args").but(args)) if args else build


def _environment(service: Node, assembler: Assembler, variables: Variables) -> Node:
    """The env files in their order, with `environment` over them."""
    environment: dict[str, Node] = {}
    for file in service.get("env_file").items:
        environment |= _of_file(file, assembler, variables, environment)
    said = service.get("environment")
    environment |= {name: bare(name, node, variables) for name, node in said.mapping.items()}
    return (service.get("env_file") if said.value is None else said).but(environment)


def _of_file(file: Node, assembler: Assembler, variables: Variables, before: dict[str, Node]) -> dict[str, Node]:
    named = file.mapping["path"]
    path = Path(named.value)
    if not file.get("required").value and not assembler.files.there(path):
        return {}
    text = assembler.files.text(path, named.where, "the env file")
    if text is None:
        return {}
    assembler.paths[path] = None
    raw = "format" in file.mapping
    earlier = {name: node.value for name, node in before.items() if node.value is not None}
    read = read_env_file(path, text, variables, assembler.files.diagnostics, raw, earlier)
    assembler.files.spend(len(read), named.where)
    return {
        name: Node(value, where, where, taken=(name,) if alone else ()) for name, (value, where, alone) in read.items()
    }


def _labels(service: Node, assembler: Assembler, variables: Variables) -> Node:
    """The labels of `label_file`, with `labels` over them."""
    files, said = service.get("label_file"), service.get("labels")
    labels: dict[str, Node] = {}
    for file in files.items:
        text = assembler.files.text(Path(file.value), file.where, "the file of labels")
        if text is not None:
            assembler.paths[Path(file.value)] = None
        read = read_env_file(Path(file.value), text or "", variables, assembler.files.diagnostics)
        assembler.files.spend(len(read), file.where)
        labels |= {name: Node(value or "", where, where) for name, (value, where, _) in read.items()}
    return (files if said.value is None else said).but({**labels, **said.mapping})
