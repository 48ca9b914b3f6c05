"""Gets the images that services need: decides what to build or pull, does it, and records each result immediately."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

from rorg.engines.protocol import Engine
from rorg.errors import RorgError
from rorg.host.clock import wall_clock
from rorg.images.build import build
from rorg.images.identity import Identities, rebuilt_identity
from rorg.images.order import LABEL_BUILDER, LABEL_IDENTITY, LABEL_IMAGE, Builder, Listener, Order, Result
from rorg.images.process import ProcessBuilder
from rorg.images.records import Built, Records
from rorg.images.references import Content, bases_of, references
from rorg.model.catalog import Catalog, Image
from rorg.model.image_names import declared, with_identity
from rorg.store.state_dir import StateDir

LOGS = "builds"
"""Folder of the state directory for the logs of builds."""


class Supplier:
    """Gets images for one engine and one state directory."""

    def __init__(self, engine: Engine, state: StateDir, owner: str, jobs: int, imports: bool = True) -> None:
        """`owner`: the instance that the images belong to; `jobs`: how many images are built at the same time. Without
        `imports`, no import command runs, so an image based on an imported one is built only if that one exists."""
        self.engine, self.state, self.owner, self.jobs, self.imports = engine, state, owner, jobs, imports
        self.records = Records(state.path)

    def make_builder(self) -> Builder:
        """A builder that puts images where the engine runs them. Its libraries are loaded with the first one. Raises
        Unreachable."""
        from rorg.engines.docker.engine import DockerEngine

        if not isinstance(self.engine, DockerEngine):
            return ProcessBuilder(self.state.path)
        from rorg.images.docker import DockerBuilder

        return DockerBuilder(self.engine, imports=self.imports)

    def orders(self, catalog: Catalog, content: Content, names: Iterable[str], cache: bool = True) -> list[Order]:
        """What supply() would do for these Images of the tree, or external references."""
        with contextlib.closing(self.make_builder()) as builder:
            return self._orders(builder, catalog, content, list(names), cache)

    def supply(
        self,
        catalog: Catalog,
        content: Content,
        names: Iterable[str],
        *,
        listener: Listener,
        stop: threading.Event | None = None,
        pull: bool = False,
        cache: bool = True,
    ) -> list[Result]:
        """Gets these images. `pull`: pull external images again first, and rebuild everything based on one that has
        changed. Without `cache`, rebuild everything."""
        wanted = list(names)
        with contextlib.closing(self.make_builder()) as builder:
            again = pull and self.engine.capabilities.images
            pulled, digests = self._pull(builder, catalog, wanted, listener, stop) if again else ([], {})
            content = self._renewed(catalog, content, digests, () if cache else wanted)
            orders = self._orders(builder, catalog, content, wanted, cache)
            known = {order.reference: order.image for order in orders}
            images = {reference: image for reference, image in known.items() if image}
            done = self._build(orders, _Noting(self, builder, catalog, content, images, listener), stop)
        told = {result.reference: result for result in pulled}
        results = [told.get(r.reference, r) if r.outcome == "present" else r for r in done]
        return [*(r for r in pulled if r.reference not in known), *results]

    def _build(self, orders: list[Order], listener: Listener, stop: threading.Event | None) -> list[Result]:
        return build(
            orders,
            self.make_builder,
            jobs=self.jobs,
            clock=time.monotonic,
            listener=listener,
            stop=stop,
            logs=self.state.path / LOGS,
        )

    def _orders(
        self, builder: Builder, catalog: Catalog, content: Content, names: list[str], cache: bool
    ) -> list[Order]:
        external_names = externals(catalog, names)
        there = builder.there({*content.references.values(), *external_names})
        if not self.engine.capabilities.images:
            there |= external_names  # such an engine pulls nothing: an image is only a name
        orders = orders_for(
            catalog,
            names,
            identities=content.identities,
            tags=content.references,
            there=there,
            owner=self.owner,
            cache=cache,
        )
        return [
            replace(order, unchanged=partial(_is_unchanged, order.image, content))
            if order.image and content.identities
            else order
            for order in orders
        ]

    def _pull(
        self, builder: Builder, catalog: Catalog, names: list[str], listener: Listener, stop: threading.Event | None
    ) -> tuple[list[Result], dict[str, str]]:
        """The results, and the digest of each reference that now exists."""
        asked = sorted(externals(catalog, names))
        there = builder.there(asked)
        results = self._build([Order(r, there=r in there, pull=r in there) for r in asked], listener, stop)
        return results, {r.reference: builder.digest(r.reference) for r in results if r.good}

    def _renewed(self, catalog: Catalog, content: Content, digests: Mapping[str, str], anew: Iterable[str]) -> Content:
        """The content with new references for images whose bases changed, and for those that are built again."""
        if not content.identities:
            return content
        by_image = references(catalog, content.identities, self.records.built(), digests)
        salt = {"built at": wall_clock()}
        for name in filter(None, (declared(n, catalog.images) for n in anew)):
            by_image[name] = with_identity(name, rebuilt_identity(content.identities[name], salt))
        return replace(content, references=by_image)


def _is_unchanged(image: Image, content: Content) -> bool:
    """Whether an image's files still have its identity: they may have been edited since the image was requested."""
    return Identities().one(image, content.identities) == content.identities[image.name]


@dataclass
class _Noting:
    """A listener that records each built image before it passes the result on. One that is not on record yet it also
    records when the build begins, since a kill may come before the end."""

    supplier: Supplier
    builder: Builder
    catalog: Catalog
    content: Content
    images: Mapping[str, Image]
    listener: Listener

    def began(self, order: Order) -> None:
        self._record(order.reference)
        self.listener.began(order)

    def step(self, order: Order, text: str) -> None:
        self.listener.step(order, text)

    def ended(self, result: Result) -> None:
        if result.outcome in ("built", "imported"):
            self._record(result.reference, result.id)
        self.listener.ended(result)

    def _record(self, reference: str, id: str = "") -> None:
        """Without an `id` only what has no record, because a build that fails must not hide the image before it."""
        image = self.images.get(reference)
        identity = self.content.identities.get(image.name) if image else None
        if image and identity and (id or identity not in self.supplier.records.built()):
            with contextlib.suppress(RorgError, OSError):  # the identity of the image finds it
                self._note(image, identity, reference, id)

    def _note(self, image: Image, identity: str, reference: str, id: str) -> None:
        external_bases = externals(self.catalog, image.bases) & set(image.bases)
        digests = {base: self.builder.digest(base) for base in sorted(external_bases)}
        bases = bases_of(self.catalog, image.name, self.content.references, digests)
        self.supplier.records.note({identity: Built(image.name, reference, id, wall_clock(), bases)})


def orders_for(
    catalog: Catalog,
    names: Iterable[str],
    *,
    identities: Mapping[str, str],
    tags: Mapping[str, str],
    there: Collection[str],
    owner: str,
    pull: bool = False,
    cache: bool = True,
) -> list[Order]:
    """Orders for these images and their bases, each after its bases. The bases of an existing image are not needed.

    `names`: Images of the tree, or external references. `identities`, `tags`: Image -> identity, and the reference in
    force. `there`: references that the engine has. `pull`: existing external images are pulled again. Without `cache`,
    the named Images are built again, and nothing that the engine kept of them is used."""
    names = list(names)
    anew = frozenset() if cache else frozenset(declared(name, catalog.images) for name in names)
    orders = _Orders(catalog, identities, tags, there, owner, pull, anew)
    for name in names:
        orders.add(name)
    return list(orders.found.values())


@dataclass(frozen=True)
class _Orders:
    """Collects orders; the first seven fields are as in orders_for()."""

    catalog: Catalog
    identities: Mapping[str, str]
    tags: Mapping[str, str]
    there: Collection[str]
    owner: str
    pull: bool
    anew: frozenset[str]
    """Images that are built again."""
    found: dict[str, Order] = field(default_factory=dict)

    def add(self, name: str) -> str:
        """Add the order of an image after those of its bases, and return its reference. There is no cycle: trees are
        checked when they are loaded."""
        image = self.catalog.images.get(declared(name, self.catalog.images))
        reference = self.tags[image.name] if image else name
        if reference in self.found:
            return reference
        present = reference in self.there
        if image is None:
            self.found[reference] = Order(reference, there=present, pull=self.pull and present)
        elif present and image.name not in self.anew:
            self.found[reference] = self._order(image, reference, {}, True)
        else:
            below = {base: self.add(base) for base in image.bases}
            self.found[reference] = self._order(image, reference, below, False)
        return reference

    def _order(self, image: Image, reference: str, below: Mapping[str, str], present: bool) -> Order:
        identity = self.identities.get(image.name, "")
        labels = {LABEL_IMAGE: image.name, LABEL_IDENTITY: identity, LABEL_BUILDER: self.owner}
        return Order(
            reference,
            image,
            also=(image.name,) if image.name != reference else (),
            labels={key: value for key, value in labels.items() if value},
            below=tuple(dict.fromkeys(below.values())),
            replacements={base: to for base, to in below.items() if base != to},
            there=present,
            cache=image.name not in self.anew,
        )


def externals(catalog: Catalog, names: Iterable[str]) -> set[str]:
    """External references that these images may need; the names may be Images of the tree or external themselves."""
    external_names, seen, pending = set[str](), set[str](), list(names)
    while pending:
        name = pending.pop()
        if name in seen:
            continue
        seen.add(name)
        image = catalog.images.get(declared(name, catalog.images))
        if image is None:
            external_names.add(name)
        else:
            pending += image.bases
    return external_names
