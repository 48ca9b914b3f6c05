"""What an import makes: manifests and other files as texts, what is to be told of it, and where each came from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rorg.manifest.models import API_VERSION
from rorg.manifest.yaml_text import one_line, yaml_text
from rorg.model.diagnostics import Diagnostic
from rorg.model.image_names import stem

FOLDERS = {
    "Service": "services",
    "Group": "groups",
    "Image": "images",
    "Profile": "profiles",
    "Network": "networks",
    "Volume": "volumes",
    "Request": "requests",
}
"""Kind -> the folder of its manifests."""
NOTE = "note"
"""Severity of a finding that says how something was carried over. A warning says what is different now."""


@dataclass(frozen=True)
class Made:
    """One manifest."""

    kind: str
    name: str
    spec: Mapping[str, Any]
    """Plain values, some with a comment (yaml_text.Noted)."""
    comments: tuple[str, ...] = ()
    """Lines above it: where it came from first."""
    labels: Mapping[str, str] = field(default_factory=dict)
    description: str = ""

    @property
    def path(self) -> str:
        """Where it belongs in a tree of manifests."""
        return f"{FOLDERS[self.kind]}/{stem(self.name)}.yaml"

    @property
    def text(self) -> str:
        """The whole file."""
        head = [f"yaml-language-server: $schema=../schemas/{self.kind.lower()}.json", *map(one_line, self.comments)]
        metadata: dict[str, Any] = {"name": self.name}
        if self.description:
            metadata["description"] = self.description
        if self.labels:
            metadata["labels"] = self.labels
        document = {"apiVersion": API_VERSION, "kind": self.kind, "metadata": metadata, "spec": self.spec}
        return "".join(f"# {line}\n" for line in head) + yaml_text(document)


@dataclass(frozen=True)
class Imported:
    """The result of an import. Nothing of it may be written where there are errors."""

    manifests: tuple[Made, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    """Other files: path in the tree -> text."""
    private: frozenset[str] = frozenset()
    """Those of `files` that only their owner may read."""
    diagnostics: tuple[Diagnostic, ...] = ()

    def with_diagnostics(self, more: Iterable[Diagnostic]) -> Imported:
        """The same, with what was found before."""
        return replace(self, diagnostics=tuple(sorted({*self.diagnostics, *more})))

    @property
    def errors(self) -> tuple[Diagnostic, ...]:
        """What keeps it from being written."""
        return tuple(d for d in self.diagnostics if d.severity == "error")

    @property
    def texts(self) -> dict[str, str]:
        """Every file of the tree: path -> text, in order."""
        return {**{made.path: made.text for made in self.manifests}, **self.files}
