"""Merges several files into one tree: files over files, services that extend others, files that include others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rorg.compose.form import Context
from rorg.compose.keys import FILE, SERVICE
from rorg.compose.nodes import Node, read_nodes
from rorg.compose.variables import Files, Variables, bare, fill
from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic, Where

MOST_INCLUDES, MOST_EXTENDS = 50, 50
"""Length of a chain of includes, and of a chain of extended services."""
MOST_LAYERS = 200
"""Documents of all files; a file that is included twice counts twice."""
RESOURCES = ("services", "networks", "volumes", "configs", "secrets")


@dataclass(frozen=True)
class Layer:
    """One document of one file: as written, with `!reset` and `!override`, and as a tree in canonical forms."""

    path: Path
    written: Node
    tree: Node

    def service(self, name: str) -> Node | None:
        found = self.tree.mapping.get("services")
        return found.mapping.get(name) if found else None

    def written_service(self, name: str) -> Node:
        services = self.written.mapping.get("services")
        found = services.mapping.get(name) if services else None
        return found or Node({}, self.written.where)


@dataclass
class Assembler:
    """State shared by all files of a project. Every mistake goes into `diagnostics`."""

    files: Files
    home: str
    diagnostics: list[Diagnostic] = field(default_factory=list)
    paths: dict[Path, None] = field(default_factory=dict)
    """All files that were read."""
    layers: dict[tuple[Path, Path, int], list[Layer]] = field(default_factory=dict)
    """By file, directory and set of variables."""
    documents: int = 0

    def tree(
        self, paths: Sequence[Path], directory: Path, variables: Variables, where: Where, trail: tuple[Path, ...] = ()
    ) -> Node:
        """The merged tree of some files and everything that they include."""
        total: Node | None = None
        for path in paths:
            for layer in self.read(path, directory, variables, where):
                services = self.extended(layer, directory, variables)
                tree = layer.tree.but({**layer.tree.mapping, **({"services": services} if services else {})})
                total = tree if total is None else FILE.merge(apply_resets(total, layer.written), tree)
        total = total or Node({}, where)
        for entry in total.mapping["include"].items if "include" in total.mapping else ():
            total = self.included(total, entry, directory, variables, (*trail, *paths))
        return total

    def read(self, path: Path, directory: Path, variables: Variables, where: Where) -> list[Layer]:
        """The documents of a file in canonical forms; none if it cannot be read, which is reported at `where`."""
        key = (path, directory, id(variables))
        if key in self.layers:
            return self.layers[key]
        self.layers[key] = []
        text = self.files.text(path, where, "the Compose file")
        if text is None:
            return []
        self.paths[path] = None
        documents, mistakes = read_nodes(text, str(path))
        self.diagnostics += mistakes
        self.documents += max(1, len(documents))
        if self.documents > MOST_LAYERS:
            raise TooMuch(
                where, f"the project has more than {MOST_LAYERS} files and documents, counted as they are read"
            )
        self.files.spend(sum(document.size() for document in documents), where)
        context = Context(directory, self.home, self.diagnostics, self.files.spend, self.files.near)
        for document in documents:
            written = fill(document, variables, self.diagnostics)
            tree = FILE.read(without_resets(written), "", context)
            if tree is not None:
                self.layers[key].append(Layer(path, written, tree))
        return self.layers[key]

    def extended(self, layer: Layer, directory: Path, variables: Variables) -> Node | None:
        services = layer.tree.mapping.get("services")
        if services is None:
            return None
        every = {name: self.service(name, layer, directory, variables, ()) for name in services.mapping}
        return services.but({name: node for name, node in every.items() if node is not None})

    def service(
        self, name: str, layer: Layer, directory: Path, variables: Variables, trail: tuple[tuple[Path, str], ...]
    ) -> Node | None:
        """A service merged with everything that it extends."""
        node = layer.service(name)
        extends = node.mapping.get("extends") if node else None
        target = extends.mapping.get("service") if extends else None
        if node is None or extends is None or target is None:
            return node
        own = node.but({key: value for key, value in node.mapping.items() if key != "extends"})
        if (layer.path, name) in trail:
            ring = [one for _, one in trail[trail.index((layer.path, name)) :]]
            if name == min(ring):  # every service of the cycle leads here once: report it only once
                message = f"services extend each other: {' -> '.join([*ring, name])}"
                self.diagnostics.append(Diagnostic(target.where, message, "removing one `extends`"))
            return own
        if len(trail) > MOST_EXTENDS:
            raise TooMuch(
                target.where, f"more than {MOST_EXTENDS} services extend each other in a row", "a shorter row"
            )
        found = self.base(name, target, extends, layer, directory, variables)
        if found is None:
            return node
        base_layer, base_directory = found
        trail = (*trail, (layer.path, name))
        base = self.service(target.value, base_layer, base_directory, variables, trail)
        if base is None:
            return own
        merged = SERVICE.merge(apply_resets(base, layer.written_service(name)), own)
        self.files.spend(merged.size(), target.where)
        return own.but(merged.value)

    def base(
        self, name: str, target: Node, extends: Node, layer: Layer, directory: Path, variables: Variables
    ) -> tuple[Layer, Path] | None:
        """The document with the service that `name` extends, and the directory that its paths are relative to."""
        layers, where = [layer], directory
        file = extends.mapping.get("file")
        if file:
            path = Path(Context(directory, self.home).path(file.value))
            layers, where = self.read(path, path.parent, variables, file.where), path.parent
            if not layers:
                return None
        found = next((one for one in layers if one.service(target.value) is not None), None)
        if found is None:
            known = [
                known for one in layers for known in one.tree.mapping.get("services", target).mapping if known != name
            ]
            inside = f" in {layers[0].path}" if file else ""
            message = f"service '{name}' extends '{target.value}', which does not exist{inside}"
            self.diagnostics.append(Diagnostic(target.where, message, self.files.near(target.value, known)))
            return None
        return found, where

    def included(
        self, total: Node, entry: Node, directory: Path, variables: Variables, trail: tuple[Path, ...]
    ) -> Node:
        """A tree merged with what one entry of `include` adds."""
        context = Context(directory, self.home)
        paths = [Path(context.path(one.value)) for one in entry.mapping["path"].items]
        if not paths or len(trail) > MOST_INCLUDES:
            self.diagnostics.append(
                Diagnostic(entry.where, "an include without a path, or nested too deep", "path: FILE")
            )
            return total
        if paths[0] in trail:
            ring = " -> ".join(path.name for path in (*trail[trail.index(paths[0]) :], paths[0]))
            self.diagnostics.append(
                Diagnostic(entry.where, f"files include each other: {ring}", "removing one include")
            )
            return total
        said = entry.mapping.get("project_directory")
        base = Path(context.path(said.value)) if said else paths[0].parent
        inner = variables.within()
        env_files = entry.mapping.get("env_file")
        if env_files:
            for one in env_files.items:
                self.env_file(Path(context.path(one.value)), one.where, inner)
        elif self.files.there(base / ".env"):
            self.env_file(base / ".env", entry.where, inner)
        tree = self.tree(paths, base, inner, entry.where, trail)
        return self.joined(total, _with_bare_names(tree, inner))

    def env_file(self, path: Path, where: Where, variables: Variables) -> None:
        text = self.files.text(path, where, "the env file")
        if text is not None:
            self.paths[path] = None
            variables.add_file(path, text, self.diagnostics)

    def joined(self, total: Node, other: Node) -> Node:
        """A tree merged with an included one. The same name in both is a mistake, unless both definitions are equal."""
        entries = dict(total.mapping)
        for section in RESOURCES:
            brought = other.mapping.get(section)
            if brought is None:
                continue
            ours = dict(entries[section].mapping) if section in entries else {}
            for name, node in brought.mapping.items():
                before = ours.get(name)
                if before is not None and before.plain() != node.plain():
                    message = f"{section}.{name} is also in the included file {node.place.file}"
                    remedy = "another name, or compose.override.yaml beside the included file in its 'path'"
                    self.diagnostics.append(Diagnostic(before.place, message, remedy))
                    continue
                ours.setdefault(name, node)
            entries[section] = (entries.get(section) or brought).but(ours)
        return total.but(entries)


def _with_bare_names(tree: Node, variables: Variables) -> Node:
    """Lets bare names in environments of an included file take values from its own env files, too."""
    services = tree.mapping.get("services")
    if services is None:
        return tree
    entries = dict(services.mapping)
    for name, service in entries.items():
        environment = service.mapping.get("environment")
        if environment:
            filled = {
                key: bare(key, node, variables) if variables.get(key) is not None else node
                for key, node in environment.mapping.items()
            }
            entries[name] = service.but({**service.mapping, "environment": environment.but(filled)})
    return tree.but({**tree.mapping, "services": services.but(entries)})


def apply_resets(base: Node, resets: Node) -> Node:
    """What remains of earlier files after `!reset` and `!override` of a later one have removed their keys."""
    entries = dict(base.mapping)
    for key, value in resets.mapping.items():
        if value.tag and key in entries:
            del entries[key]
        elif key in entries and isinstance(value.value, dict) and isinstance(entries[key].value, dict):
            entries[key] = apply_resets(entries[key], value)
    return base.but(entries)


def without_resets(node: Node) -> Node:
    """A node without entries that only remove something (`!reset`)."""
    if isinstance(node.value, dict):
        return node.but({k: without_resets(v) for k, v in node.value.items() if v.tag != "reset"})
    if isinstance(node.value, list):
        return node.but([without_resets(v) for v in node.value if v.tag != "reset"])
    return node
