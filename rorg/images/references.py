"""Decides which reference names the content of each image of a tree: what services run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from rorg.images.identity import Identities, rebuilt_identity
from rorg.images.records import Built, Records
from rorg.model.catalog import Catalog
from rorg.model.engines import ENGINES
from rorg.model.graph import parents_first
from rorg.model.image_names import declared, with_identity


@dataclass(frozen=True, kw_only=True)
class Content:
    """The content of the images of a tree."""

    identities: Mapping[str, str] = field(default_factory=dict)
    """Image -> its identity."""
    references: Mapping[str, str] = field(default_factory=dict)
    """Image -> the reference for this content."""

    @cached_property
    def names(self) -> Mapping[str, str]:
        """Reference -> its Image."""
        return {reference: name for name, reference in self.references.items()}

    def named(self, reference: str) -> str:
        """The Image of a reference, or the reference itself."""
        return self.names.get(reference, reference)


class References:
    """References in one state directory. If images are only names to the engine, the name is the reference."""

    def __init__(self, records: Records, by_content: bool = True) -> None:
        self.records, self.by_content = records, by_content
        self.identities = Identities()

    def of(self, catalog: Catalog) -> Content:
        if not self.by_content:
            return Content(references={name: name for name in catalog.images})
        identities = self.identities.of(catalog)
        return Content(identities=identities, references=references(catalog, identities, self.records.built()))


def references_for(engine: str, folder: Path) -> References:
    """The references of a state directory, for the engine with this name."""
    return References(Records(folder), engine in ENGINES and ENGINES[engine].images)


def references(
    catalog: Catalog,
    identities: Mapping[str, str],
    built: Mapping[str, Built],
    digests: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Image -> reference, from its identity. An image gets a new reference if its bases have changed since its last
    build: a parent was rebuilt, or an external base has a new digest. `built`: the last build of each identity;
    `digests`: reference -> digest, if they are known. Pure."""
    by_image: dict[str, str] = {}
    for name in parents_first(catalog.images):
        identity = identities[name]
        bases = bases_of(catalog, name, by_image, digests or {})
        last = built.get(identity)
        if last is None:
            by_image[name] = with_identity(name, identity)
        elif all(last.bases.get(reference, now) == now for reference, now in bases.items()):
            by_image[name] = last.reference
        else:
            by_image[name] = with_identity(name, rebuilt_identity(identity, {**last.bases, **bases}))
    return by_image


def bases_of(catalog: Catalog, name: str, references: Mapping[str, str], digests: Mapping[str, str]) -> dict[str, str]:
    """Base of an image -> what it is: the reference of an image of the tree, or the digest of an external one. Bases of
    unknown digest are left out."""
    bases = {}
    for base in catalog.images[name].bases:
        own = declared(base, catalog.images)
        if own:
            bases[base] = references[own]
        elif base in digests:
            bases[base] = digests[base]
    return bases
