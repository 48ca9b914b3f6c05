"""Which images are to be had for what a tree declares, as orders."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from rorg.images.order import LABEL_BUILDER, LABEL_IDENTITY, LABEL_IMAGE, Order
from rorg.model.catalog import Catalog, Image
from rorg.model.image_names import declared


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
