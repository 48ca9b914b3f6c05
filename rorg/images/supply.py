"""Getting images: what is to be built or pulled is made out, done, and written down as soon as it is done."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from rorg.engines.protocol import Engine
from rorg.errors import RorgError
from rorg.host.clock import wall_clock
from rorg.images.build import build
from rorg.images.identity import Identities, renewed
from rorg.images.order import LABEL_BUILDER, LABEL_IDENTITY, LABEL_IMAGE, Builder, Listener, Order, Result
from rorg.images.process import ProcessBuilder
from rorg.images.records import Built, Records
from rorg.images.references import Content, bases_of, references
from rorg.model.catalog import Catalog, Image
from rorg.model.image_names import declared, with_identity
from rorg.store.state_dir import StateDir


@dataclass(frozen=True, slots=True, kw_only=True)
class Supplier:
    """Of one state directory. `clock` gives seconds, `wall` ISO 8601 in UTC."""

    make_builder: Callable[[], Builder]
    records: Records
    logs: Path
    owner: str
    clock: Callable[[], float]
    wall: Callable[[], str]
    jobs: int

    def orders(self, catalog: Catalog, content: Content, names: Iterable[str], cache: bool = True) -> list[Order]:
        """What would be done to have these: Images of the tree, or external references."""
        builder = self.make_builder()
        try:
            return self._orders(builder, catalog, content, list(names), cache)
        finally:
            builder.close()

    def supply(
        self,
        catalog: Catalog,
        content: Content,
        names: Iterable[str],
        listener: Listener,
        stop: threading.Event | None = None,
        pull: bool = False,
        cache: bool = True,
    ) -> list[Result]:
        """Has these images. `pull`: external ones are pulled anew first, and what stands on one that is another one
        then is built again. Without `cache` all is built again."""
        builder, wanted = self.make_builder(), list(names)
        try:
            pulled, digests = self._pull(builder, catalog, wanted, listener, stop) if pull else ([], {})
            content = self._renewed(catalog, content, digests, () if cache else wanted)
            orders = self._orders(builder, catalog, content, wanted, cache)
            known = {order.reference for order in orders}
            noting = _Noting(self, builder, catalog, content, orders, listener)
            done = build(
                orders,
                self.make_builder,
                jobs=self.jobs,
                clock=self.clock,
                listener=noting,
                stop=stop,
                logs=self.logs,
            )
        finally:
            builder.close()
        told = {result.reference: result for result in pulled}
        results = [told.get(r.reference, r) if r.outcome == "present" else r for r in done]
        return [*(r for r in pulled if r.reference not in known), *results]

    def _orders(
        self, builder: Builder, catalog: Catalog, content: Content, names: list[str], cache: bool
    ) -> list[Order]:
        there = builder.there({*content.references.values(), *externals(catalog, names)})
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
            replace(order, unchanged=partial(_is_still, order.image, content))
            if order.image and content.identities
            else order
            for order in orders
        ]

    def _pull(
        self,
        builder: Builder,
        catalog: Catalog,
        names: list[str],
        listener: Listener,
        stop: threading.Event | None,
    ) -> tuple[list[Result], dict[str, str]]:
        """What became of it, and reference -> digest of what is there."""
        asked = sorted(externals(catalog, names))
        there = builder.there(asked)
        orders = [Order(r, there=r in there, pull=r in there) for r in asked]
        results = build(
            orders, self.make_builder, jobs=self.jobs, clock=self.clock, listener=listener, stop=stop, logs=self.logs
        )
        return results, {r.reference: builder.digest(r.reference) for r in results if r.good}

    def _renewed(self, catalog: Catalog, content: Content, digests: Mapping[str, str], anew: Iterable[str]) -> Content:
        """With what stands on other bases, and what is built anew, under other references."""
        if not content.identities:
            return content
        found = references(catalog, content.identities, self.records.built(), digests)
        salt = {"built at": self.wall()}
        for name in filter(None, (declared(n, catalog.images) for n in anew)):
            found[name] = with_identity(name, renewed(content.identities[name], salt))
        return replace(content, references=found)


def _is_still(image: Image, content: Content) -> bool:
    """Whether an image's files are those of its identity: somebody may have changed them since it was asked for."""
    return Identities().one(image, content.identities) == content.identities[image.name]


class _Noting:
    """A listener that writes down what was built before it tells it."""

    def __init__(
        self,
        supplier: Supplier,
        builder: Builder,
        catalog: Catalog,
        content: Content,
        orders: Iterable[Order],
        listener: Listener,
    ) -> None:
        self.supplier, self.builder, self.catalog, self.content = supplier, builder, catalog, content
        self.images = {order.reference: order.image for order in orders if order.image}
        self.began, self.step, self.listener = listener.began, listener.step, listener

    def ended(self, result: Result) -> None:
        image = self.images.get(result.reference)
        identity = self.content.identities.get(image.name) if image else None
        if image and identity and result.outcome in ("built", "imported"):
            with contextlib.suppress(RorgError, OSError):  # it is there all the same, and found by its identity
                self._note(image, identity, result)
        self.listener.ended(result)

    def _note(self, image: Image, identity: str, result: Result) -> None:
        found = externals(self.catalog, image.bases) & set(image.bases)
        digests = {base: self.builder.digest(base) for base in sorted(found)}
        bases = bases_of(self.catalog, image.name, self.content.references, digests)
        built = Built(image.name, result.reference, result.id, self.supplier.wall(), bases)
        self.supplier.records.note({identity: built})


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
    """Orders for these images and what they stand on, each after those. `names` are of Images of the tree, or external
    references; what an Image that is there stands on is not needed. `identities` and `tags`: Image -> identity, and the
    reference that is in force; `there`: references that the engine has. `pull`: external ones that are there are pulled
    anew. Without `cache` the named Images are built again, and nothing is used that the engine kept of them."""
    found: dict[str, Order] = {}
    names = list(names)
    anew = set() if cache else {declared(name, catalog.images) for name in names}

    def add(name: str) -> str:
        """The reference of its order. Trees are checked when they are loaded: there is no circle."""
        image = catalog.images.get(declared(name, catalog.images))
        reference = tags[image.name] if image else name
        if reference in found:
            return reference
        if image is None:
            found[reference] = Order(reference, there=name in there, pull=pull and name in there)
        elif reference in there and image.name not in anew:
            found[reference] = order(image, reference, {}, True)
        else:
            found[reference] = order(image, reference, {base: add(base) for base in image.bases}, False)
        return reference

    def order(image: Image, reference: str, below: Mapping[str, str], present: bool) -> Order:
        labels = {LABEL_IMAGE: image.name, LABEL_IDENTITY: identities.get(image.name, ""), LABEL_BUILDER: owner}
        return Order(
            reference,
            image,
            also=(image.name,) if image.name != reference else (),
            labels={key: value for key, value in labels.items() if value},
            below=tuple(dict.fromkeys(below.values())),
            replacements={base: to for base, to in below.items() if base != to},
            there=present,
            cache=image.name not in anew,
        )

    for name in names:
        add(name)
    return list(found.values())


def externals(catalog: Catalog, names: Iterable[str]) -> set[str]:
    """External references that these images, Images of the tree or not, can need."""
    found: set[str] = set()
    pending = list(names)
    seen: set[str] = set()
    while pending:
        name = pending.pop()
        if name in seen:
            continue
        seen.add(name)
        image = catalog.images.get(declared(name, catalog.images))
        if image is None:
            found.add(name)
        else:
            pending += image.bases
    return found


LOGS = "builds"
"""Folder of the state directory for the logs of builds."""


def make_supplier(engine: Engine, state: StateDir, owner: str, jobs: int, imports: bool = True) -> Supplier:
    """`owner`: the instance whose images they are; `jobs`: images that are built at once. Without `imports` no command
    of an import is run, so what stands on such an image is not built unless that is there."""
    return Supplier(
        make_builder=lambda: make_builder(engine, state, imports),
        records=Records(state.path),
        logs=state.path / LOGS,
        owner=owner,
        clock=time.monotonic,
        wall=wall_clock,
        jobs=jobs,
    )


def make_builder(engine: Engine, state: StateDir, imports: bool = True) -> Builder:
    """One that has images where this engine runs them. What it needs is loaded with the first one. Raises
    Unreachable."""
    from rorg.engines.docker.engine import DockerEngine

    if not isinstance(engine, DockerEngine):
        return ProcessBuilder(state.path)
    from rorg.images.docker import DockerBuilder

    return DockerBuilder(engine, imports=imports)
