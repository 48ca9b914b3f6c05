"""Finds fields by paths as people write them: `service.spec.idle.linger`, `spec.ready`, `container.devices`."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from dataclasses import dataclass

from pydantic import BaseModel

from rorg.manifest.container import ContainerOptions
from rorg.manifest.field_texts import FieldText, fields_of
from rorg.manifest.models import ENVELOPES, FOLDERS, SPECS, Manifest, Metadata

CONTAINER = "service.spec.container"


@dataclass(frozen=True)
class Place:
    """A field, or a kind of manifest."""

    path: str
    field: FieldText | None
    """None for a kind."""
    model: type[BaseModel] | None
    """The model of the mapping at this place, if it is one."""

    def deeper(self, word: str) -> Place | None:
        """The field of that name in this mapping. User-chosen keys, as in ulimits, lead to the same model."""
        field = fields_of(self.model).get(word) if self.model else None
        if field:
            return Place(f"{self.path}.{word}" if self.path else word, field, field.model)
        chosen = self.field and self.model and "mapping of" in self.field.form and not self.path.endswith("NAME")
        return Place(f"{self.path}.NAME", self.field, self.model) if chosen else None


def find(path: str) -> Place | None:
    """Finds the place of a path, or None. The kind and `spec` may be omitted."""
    words = [re.sub(r"\[\w*\]$", "", word) for word in path.split(".")]
    for place, rest in _starts(words):
        target: Place | None = place
        for word in rest:
            target = target.deeper(word) if target else None
        if target:
            return target
    return None


def _starts(words: list[str]) -> Iterator[tuple[Place, list[str]]]:
    """Yields possible starts of a path with the remaining words, the likeliest first."""
    first, rest = words[0].lower(), words[1:]
    folders = {folder: kind for folder, kind in FOLDERS.items() if folder not in ContainerOptions.model_fields}
    kinds = {kind.lower(): kind for kind in SPECS} | folders
    if first in kinds:
        kind = kinds[first]
        place = Place(kind.lower(), None, SPECS[kind])
        if not rest:
            yield place, []
        elif rest[0] == "spec":
            yield _spec(kind), rest[1:]
        else:
            yield _spec(kind), rest
            yield Place(kind.lower(), None, ENVELOPES[kind]), rest
        return
    if first == "container":
        yield Place(CONTAINER, fields_of(SPECS["Service"])["container"], ContainerOptions), rest
    if first == "metadata":
        yield Place("service.metadata", fields_of(Manifest)["metadata"], Metadata), rest
    for kind in SPECS:
        yield _spec(kind), rest if first == "spec" else words
    if words == ["apiVersion"] or words == ["kind"]:
        yield Place("service", None, Manifest), words


def _spec(kind: str) -> Place:
    return Place(f"{kind.lower()}.spec", None, SPECS[kind])


def all_paths() -> list[str]:
    """Every field of every kind."""
    paths = [kind.lower() for kind in SPECS]
    paths += [f"service.metadata.{name}" for name in fields_of(Metadata)]
    pending = [_spec(kind) for kind in SPECS]
    for place in pending:  # it grows during the loop
        for name, field in fields_of(place.model).items() if place.model else ():
            paths.append(f"{place.path}.{name}")
            if field.model:
                pending.append(Place(paths[-1], field, field.model))
    return paths


def nearest_path(path: str) -> str:
    """The known path closest to a misspelt one; empty if none is close."""
    words = path.split(".")
    for end in range(len(words) - 1, 0, -1):
        place = find(".".join(words[:end]))
        if place and place.model:
            near = difflib.get_close_matches(words[end], fields_of(place.model), 1)
            if near:
                return f"{place.path}.{near[0]}"
    paths = all_paths()
    by_last = {known.rpartition(".")[2]: known for known in reversed(paths)}
    near = difflib.get_close_matches(words[-1], by_last, 1, 0.7)
    return by_last[near[0]] if near else ""
