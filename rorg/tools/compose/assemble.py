"""Merges several files into one tree: files over files, services that extend others, files that include others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Where
from rorg.tools.compose.form import Context
from rorg.tools.compose.keys import FILE, SERVICE
from rorg.tools.compose.nodes import Node, read_nodes
from rorg.tools.compose.project import VALUE
from rorg.tools.compose.variables import Files, Variables, bare, fill

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

    @property
    def services(self) -> Mapping[str, Node]:
        return self.tree.get("services").mapping


@dataclass
class Assembler:
    """State shared by all files of a project. Every mistake goes into the diagnostics of `files`."""

    files: Files
    home: str
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
                tree = self.extended(layer, directory, variables)
                total = tree if total is None else FILE.merge(apply_resets(total, layer.written), tree)
        total = total or Node({}, where)
        for entry in total.get("include").items:
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
        self.files.diagnostics += mistakes
        self.documents += max(1, len(documents))
        if self.documents > MOST_LAYERS:
            raise TooMuch(
                where, f"the project has more than {MOST_LAYERS} files and documents, counted as they are read"
            )
        self.files.spend(sum(document.size() for document in documents), where)
        context = Context(directory, self.home, self.files)
        for document in documents:
            written = fill(document, variables, self.files.diagnostics)
            tree = FILE.read(without_resets(written), "", context)
            if tree is not None:
                self.layers[key].append(Layer(path, written, tree))
        return self.layers[key]

    def extended(self, layer: Layer, directory: Path, variables: Variables) -> Node:
        """The tree of a document, with every service merged with everything that it extends."""
        if not layer.services:
            return layer.tree
        every = {name: self.service(name, layer, directory, variables, ()) for name in layer.services}
        services = {name: node for name, node in every.items() if node is not None}
        return layer.tree.having(services=layer.tree.get("services").but(services))

    def service(
        self, name: str, layer: Layer, directory: Path, variables: Variables, trail: tuple[tuple[Path, str], ...]
    ) -> Node | None:
        """A service merged with everything that it extends."""
        node = layer.services.get(name)
        extends = node.get("extends") if node else None
        if node is None or extends is None or not extends.mapping:
            return node
        target = extends.get("service")
        own = node.but({key: value for key, value in node.mapping.items() if key != "extends"})
        if (layer.path, name) in trail:
            ring = [one for _, one in trail[trail.index((layer.path, name)) :]]
            if name == min(ring):  # every service of the cycle leads here once: report it only once
                message = f"services extend each other: {' -> '.join([*ring, name])}"
                self.files.error(target.where, message, "to remove one `extends`")
            return own
        if len(trail) > MOST_EXTENDS:
            raise TooMuch(
                target.where, f"more than {MOST_EXTENDS} services extend each other in a row", "a shorter row"
            )
        origin = self.base(name, target, extends, layer, directory, variables)
        if origin is None:
            return node
        base_layer, base_directory = origin
        trail = (*trail, (layer.path, name))
        base = self.service(target.value, base_layer, base_directory, variables, trail)
        if base is None:
            return own
        merged = SERVICE.merge(apply_resets(base, layer.written.get("services", name)), own)
        self.files.spend(merged.size(), target.where)
        return own.but(merged.value)

    def base(
        self, name: str, target: Node, extends: Node, layer: Layer, directory: Path, variables: Variables
    ) -> tuple[Layer, Path] | None:
        """The document with the service that `name` extends, and the directory that its paths are relative to."""
        layers, where = [layer], directory
        file = extends.get("file")
        if file.value:
            path = Path(Context(directory, self.home, self.files).path(file.value))
            layers, where = self.read(path, path.parent, variables, file.where), path.parent
            if not layers:
                return None
        document = next((one for one in layers if target.value in one.services), None)
        if document is None:
            known = [known for one in layers for known in one.services if known != name]
            inside = f" in {layers[0].path}" if file.value else ""
            message = f"service '{name}' extends '{target.value}', which does not exist{inside}"
            self.files.error(target.where, message, self.files.near(target.value, known))
            return None
        return document, where

    def included(
        self, total: Node, entry: Node, directory: Path, variables: Variables, trail: tuple[Path, ...]
    ) -> Node:
        """A tree merged with what one entry of `include` adds."""
        context = Context(directory, self.home, self.files)
        paths = [Path(context.path(one.value)) for one in entry.get("path").items]
        if not paths or len(trail) > MOST_INCLUDES:
            self.files.error(entry.where, "an include without a path, or nested too deep", "path: FILE")
            return total
        if paths[0] in trail:
            ring = " -> ".join(path.name for path in (*trail[trail.index(paths[0]) :], paths[0]))
            self.files.error(entry.where, f"files include each other: {ring}", "to remove one include")
            return total
        said = entry.get("project_directory").value
        base = Path(context.path(said)) if said is not None else paths[0].parent
        inner = variables.within()
        for one in entry.get("env_file").items:
            self.env_file(Path(context.path(one.value)), one.where, inner)
        if "env_file" not in entry.mapping and self.files.there(base / ".env"):
            self.env_file(base / ".env", entry.where, inner)
        tree = self.tree(paths, base, inner, entry.where, trail)
        return self.joined(total, _with_contents(_with_bare_names(tree, inner), inner))

    def env_file(self, path: Path, where: Where, variables: Variables) -> None:
        text = self.files.text(path, where, "the env file")
        if text is not None:
            self.paths[path] = None
            variables.add_file(path, text, self.files.diagnostics)

    def joined(self, total: Node, other: Node) -> Node:
        """A tree merged with an included one. The same name in both is a mistake, unless both definitions are equal."""
        for section in RESOURCES:
            if section not in other.mapping:
                continue
            ours = dict(total.get(section).mapping)
            for name, node in other.get(section).mapping.items():
                before = ours.get(name)
                if before is not None and before.plain() != node.plain():
                    message = f"{section}.{name} is also in the included file {node.place.file}"
                    remedy = "another name, or compose.override.yaml beside the included file in its 'path'"
                    self.files.error(before.place, message, remedy)
                    continue
                ours.setdefault(name, node)
            total = total.having(**{section: (total.mapping.get(section) or other.get(section)).but(ours)})
        return total


def _with_bare_names(tree: Node, variables: Variables) -> Node:
    """Lets bare names in environments of an included file take values from its own env files, too."""
    services, replacements = tree.get("services"), dict[str, Node]()
    for name, service in services.mapping.items():
        environment = service.get("environment")
        own = {
            key: bare(key, one, variables) for key, one in environment.mapping.items() if variables.get(key) is not None
        }
        if own:
            replacements[name] = service.having(environment=environment.having(**own))
    return tree.having(services=services.having(**replacements)) if replacements else tree


def _with_contents(tree: Node, variables: Variables) -> Node:
    """Lets configs and secrets of an included file take their contents from its own env files, too."""
    for kind in ("configs", "secrets"):
        given = {
            name: node.having(**{VALUE: said.but(variables.take(said.value, said.where), taken=(said.value,))})
            for name, node in tree.get(kind).mapping.items()
            if isinstance((said := node.get("environment")).value, str) and variables.get(said.value) is not None
        }
        tree = tree.having(**{kind: tree.get(kind).having(**given)}) if given else tree
    return tree


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
