"""Additional build contexts, which a Dockerfile uses by name, and `cache_from`.

An image as a context replaces the name in the Dockerfile. A directory becomes an Image of its own that holds only its
files, so that every builder can copy from it. rorg builds, keeps and prunes it like any other Image.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from rorg.manifest.dockerfile import Dockerfile, Use
from rorg.manifest.documents import Source
from rorg.manifest.files import real
from rorg.manifest.option_checks import check_image
from rorg.model.catalog import Image, Service
from rorg.model.diagnostics import Diagnostic, Reading, nearest
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


class _Wrong(Exception):
    """(message, remedy) about one context."""


def contexts_of(source: Source, services: Mapping[str, Service], images: Collection[str]) -> Reading[Contexts]:
    """Reads the additional contexts of an Image. `images` are the names of all Images of the tree."""
    contexts = Contexts()
    for name, value in source.spec.additional_contexts.items():
        try:
            contexts.stands_for[plain(name)] = _reference(contexts, source, name, value, services, images)
        except _Wrong as wrong:
            where, (message, remedy) = source.where("spec", "additional_contexts", name), wrong.args
            yield Diagnostic(where, f"additional_contexts.{name}: {message}", remedy)
    return contexts


def _reference(
    contexts: Contexts, source: Source, name: str, value: str, services: Mapping[str, Service], images: Collection[str]
) -> str:
    """The reference of the image that a context is, or becomes. Raises _Wrong."""
    if match := REFERENCE.fullmatch(value):
        try:
            check_image(match[1])
        except ValueError as error:
            raise _Wrong(str(error), TAKEN) from None
        return match[1]
    if value.startswith("service:"):
        used = {n: str(s.spec["image"]) for n, s in services.items() if s.spec is not None}
        service = value.removeprefix("service:")
        if service not in used:
            raise _Wrong(f"'{value}' is not a service with an image", nearest(service, used))
        return used[service]
    if REMOTE.match(value):
        raise _Wrong(f"rorg cannot build from '{value}' on any engine", TAKEN)
    return declared(value, images) or _directory(contexts, source, name, value, images)


def _directory(contexts: Contexts, source: Source, name: str, value: str, images: Collection[str]) -> str:
    """Makes an Image from a directory and returns its name. Raises _Wrong."""
    path = str(real(source.directory / os.path.expanduser(value)))
    if not os.path.isdir(path):
        raise _Wrong(f"no directory {path}", "to create it, or use " + TAKEN)
    called = f"{plain(source.name).replace(':', '-')}-{re.sub(r'[^a-z0-9]+', '-', name.lower()).strip('-')}-context"
    try:
        check_name(called)
    except ValueError:
        raise _Wrong(f"'{name}' cannot name a context", "small letters and digits") from None
    if called in images or called in contexts.made:
        raise _Wrong(f"its files become the image '{called}', which already exists", "another name for one of the two")
    where, folder = source.where("spec", "additional_contexts", name), str(real(source.directory))
    contexts.made[called] = Image(called, path, "Dockerfile", {}, None, folder, where, inline=FILES)
    return called


def stood_in(
    image: Image, source: Source, whole: Dockerfile, uses: tuple[Use, ...], contexts: Contexts
) -> Reading[tuple[Image, tuple[Use, ...]]]:
    """Replaces the names of contexts in the image and in its uses. `whole` is the complete Dockerfile, even if only
    some stages are built. Reports names that nothing uses, and refuses the name of a stage: Docker would use the
    context in its place, and not every builder can."""
    names = {
        use.reference: contexts.stands_for[plain(use.reference)]
        for use in uses
        if plain(use.reference) in contexts.stands_for
    }
    for name in source.spec.additional_contexts:
        where = source.where("spec", "additional_contexts", name, key=True)
        if name.lower() in map(str.lower, whole.stages):
            message = f"additional_contexts.{name}: {image.dockerfile} has a stage of that name"
            yield Diagnostic(where, message, "another name for one of the two")
        elif plain(name) in contexts.stands_for and plain(name) not in {plain(use.reference) for use in whole.uses}:
            message = f"{image.dockerfile} uses no '{name}', so this changes nothing"
            yield Diagnostic(where, message, f"COPY --from={name} in it", "warning")
    used = tuple(replace(use, reference=names.get(use.reference, use.reference)) for use in uses)
    return replace(image, stand_ins=names), used


def cache_of(source: Source) -> Reading[tuple[str, ...]]:
    """Returns images whose layers a build may use. They do not change the result of the build."""
    images = []
    for index, value in enumerate(source.spec.cache_from):
        match = CACHE.fullmatch(value)
        try:
            check_image(match[1] if match else value)
            images.append(match[1] if match else value)
        except ValueError:
            where = source.where("spec", "cache_from", index)
            message = f"cache_from: '{value}' is not an image, and rorg takes layers from nothing else"
            yield Diagnostic(where, message, "name:tag, or type=registry,ref=name:tag")
    return tuple(images)
