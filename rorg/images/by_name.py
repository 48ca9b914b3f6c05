"""A builder for an engine, and orders for it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rorg.engines.protocol import RealEngine
from rorg.images.order import Builder, Order
from rorg.images.orders import externals, orders_for
from rorg.images.process import ProcessBuilder
from rorg.model.catalog import Catalog


def make_builder(engine: RealEngine, state: Path) -> Builder:
    """One that has images where this engine runs them. Raises Unreachable."""
    from rorg.engines.docker.engine import DockerEngine

    if not isinstance(engine, DockerEngine):
        return ProcessBuilder(state)
    from rorg.images.docker import DockerBuilder

    return DockerBuilder(engine)


def orders_by_name(
    catalog: Catalog, names: Iterable[str], builder: Builder, owner: str, pull: bool = False, cache: bool = True
) -> list[Order]:
    """Orders for images whose references are their names. External and imported ones that are there are left as they
    are; the others are built, by an engine that knows what it has built already."""
    names = list(names)
    imported = {name for name, image in catalog.images.items() if image.import_command is not None}
    there = builder.there(externals(catalog, names) | imported)
    tags = {name: name for name in catalog.images}
    return orders_for(catalog, names, identities={}, tags=tags, there=there, owner=owner, pull=pull, cache=cache)
