"""Additional build contexts, which a Dockerfile uses by name, and `cache_from`.

An image as a context replaces the name in the Dockerfile. A directory becomes an Image of its own that holds only its
files, so that every builder can copy from it. rorg builds, keeps and prunes it like any other Image.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rorg.manifest.dockerfile import Dockerfile, Use
from rorg.manifest.documents import Source
from rorg.manifest.files import real
from rorg.manifest.option_checks import check_image
from rorg.model.catalog import Image, Service
from rorg.model.diagnostics import Diagnostic, Where, nearest
from rorg.model.image_names import check_name, declared, plain

FILES = "FROM scratch\nCOPY . /\n"
"""The Dockerfile of an image that is made from a directory."""
REFERENCE = re.compile(r"(?:docker-image://|image:)(.*)", re.DOTALL)
REMOTE = re.compile(r"[a-z][a-z+-]*://|git@|(?:target|oci-layout):", re.IGNORECASE)
CACHE = re.compile(r"type=registry,ref=([^,]+)")
TAKEN = "./directory, docker-image://REFERENCE, service:NAME or the name of an Image"


@dataclass
class Contexts:
    """The contexts of one Image. `stands_for`: name in the Dockerfile (in its shortest form) -> reference of an
    image."""

    stands_for: dict[str, str] = field(default_factory=dict)
    made: dict[str, Image] = field(default_factory=dict)
    diagnostics: list[Diagnostic] = field(default_factory=list)


def contexts_of(source: Source, services: Mapping[str, Service], images: Collection[str]) -> Contexts:
    """Reads the additional contexts of an Image. `images` are the names of all Images of the tree."""
    found = Contexts()
    for name, value in source.spec.additional_contexts.items():
        where = source.where("spec", "additional_contexts", name)
        wrong = _read(found, source, name, value, services, images, where)
        if wrong:
            found.diagnostics.append(Diagnostic(where, f"additional_contexts.{name}: {wrong[0]}", wrong[1]))
    return found


def _read(
    found: Contexts,
    source: Source,
    name: str,
    value: str,
    services: Mapping[str, Service],
    images: Collection[str],
    where: Where,
) -> tuple[str, str] | None:
    """Adds one context to `found`, or returns (what is wrong, remedy)."""
    reference, wrong = "", None
    if match := REFERENCE.fullmatch(value):
        reference = match[1]
        wrong = _no_reference(reference)
    elif value.startswith("service:"):
        service = services.get(value.removeprefix("service:"))
        if service is None or service.spec is None:
            known = {n for n, s in services.items() if s.spec is not None}
            return f"'{value}' is not a service with an image", nearest(value.removeprefix("service:"), known)
        reference = str(service.spec["image"])
    elif REMOTE.match(value):
        wrong = f"rorg cannot build from '{value}' on any engine", TAKEN
    elif declared(value, images):
        reference = declared(value, images)
    else:
        reference, wrong = _directory(found, source, name, value, images, where)
    if not wrong:
        found.stands_for[plain(name)] = reference
    return wrong


def _no_reference(text: str) -> tuple[str, str] | None:
    try:
        check_image(text)
    except ValueError as error:
        return str(error), TAKEN
    return None


def _directory(
    found: Contexts, source: Source, name: str, value: str, images: Collection[str], where: Where
) -> tuple[str, tuple[str, str] | None]:
    """Returns the name of the Image that a directory becomes, or (what is wrong, remedy)."""
    path = str(real(source.directory / os.path.expanduser(value)))
    if not os.path.isdir(path):
        return "", (f"no directory {path}", "creating it, or " + TAKEN)
    called = f"{plain(source.name).replace(':', '-')}-{re.sub(r'[^a-z0-9]+', '-', name.lower()).strip('-')}-context"
    try:
        check_name(called)
    except ValueError:
        return "", (f"'{name}' cannot name a context", "small letters and digits")
    if called in images or called in found.made:
        return "", (f"its files become the image '{called}', which already exists", "another name for one of the two")
    image = Image(called, path, "Dockerfile", {}, None, str(real(source.directory)), where, inline=FILES)
    found.made[called] = replace(image, bases=())
    return called, None


def stood_in(
    image: Image, source: Source, whole: Dockerfile, uses: tuple[Use, ...], found: Contexts
) -> tuple[Image, tuple[Use, ...], list[Diagnostic]]:
    """Replaces the names of contexts in the image and in its uses. `whole` is the complete Dockerfile, even if only
    some stages are built. Reports names that nothing uses, and refuses the name of a stage: Docker would use the
    context in its place, and not every builder can."""
    names = {
        use.reference: found.stands_for[plain(use.reference)]
        for use in uses
        if plain(use.reference) in found.stands_for
    }
    told: list[Diagnostic] = []
    for name in source.spec.additional_contexts:
        where = source.where("spec", "additional_contexts", name, key=True)
        if name.lower() in map(str.lower, whole.stages):
            message = f"additional_contexts.{name}: {image.dockerfile} has a stage of that name"
            told.append(Diagnostic(where, message, "another name for one of the two"))
        elif plain(name) in found.stands_for and plain(name) not in {plain(use.reference) for use in whole.uses}:
            message = f"{image.dockerfile} uses no '{name}', so this changes nothing"
            told.append(Diagnostic(where, message, f"COPY --from={name} in it", "warning"))
    used = tuple(replace(use, reference=names.get(use.reference, use.reference)) for use in uses)
    return replace(image, stand_ins=names), used, told


def cache_of(source: Source) -> tuple[tuple[str, ...], list[Diagnostic]]:
    """Returns images whose layers a build may use. They do not change the result of the build."""
    spec: Any = source.spec
    found, diagnostics = [], []
    for index, value in enumerate(spec.cache_from):
        match = CACHE.fullmatch(value)
        reference = match[1] if match else value
        wrong = _no_reference(reference)
        if wrong:
            where = source.where("spec", "cache_from", index)
            message = f"cache_from: '{value}' is not an image, and rorg takes layers from nothing else"
            diagnostics.append(Diagnostic(where, message, "name:tag, or type=registry,ref=name:tag"))
        else:
            found.append(reference)
    return tuple(found), diagnostics
