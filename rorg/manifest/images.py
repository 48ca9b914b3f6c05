"""Images of a tree: the references in their Dockerfiles, and what is wrong with these."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from rorg.manifest.build_contexts import Contexts, cache_of, contexts_of, stood_in
from rorg.manifest.dockerfile import Dockerfile, DockerfileError, Use, read
from rorg.manifest.documents import Source, unexpected
from rorg.manifest.files import read_text, real
from rorg.model.catalog import Image, Service
from rorg.model.diagnostics import Diagnostic, Reading, Where, close_to, nearest
from rorg.model.graph import cycles, stands_on
from rorg.model.image_names import plain

ALIKE = 0.8
"""Similarity (of difflib) above which a base counts as a misspelt Image."""
PREDEFINED = re.compile(
    r"(?i:(https?|ftp|no|all)_proxy)|BUILDKIT_\w+|SOURCE_DATE_EPOCH|(TARGET|BUILD)(PLATFORM|OS|ARCH|VARIANT)|TARGETSTAGE"
)
"""Arguments that need no ARG (Dockerfile reference, "Predefined ARGs")."""
MACHINES = {"x86_64": "linux/amd64", "aarch64": "linux/arm64", "armv7l": "linux/arm/v7", "riscv64": "linux/riscv64"}
"""Platforms by the kernel's name of the machine; unknown ones count as the first."""
MOST = 256 << 10
"""Bytes of a Dockerfile."""
Used = Mapping[str, tuple[Use, ...]]
"""By the name of the Image."""


def images_of(sources: Mapping[str, Source], services: Mapping[str, Service]) -> Reading[dict[str, Image]]:
    """Returns all Images with the references in their Dockerfiles. Errors: a Dockerfile that is missing, unreadable or
    without the target stage, and Images that depend on each other. Warnings: arguments without an ARG, and bases that
    look like a misspelt Image."""
    images: dict[str, Image] = {}
    used: dict[str, tuple[Use, ...]] = {}
    for name, source in sources.items():
        contexts = yield from contexts_of(source, services, sources)
        cache = yield from cache_of(source)
        image, used[name] = yield from _used(replace(_declared(source), cache_from=cache), source, contexts)
        images[name] = replace(image, bases=tuple(dict.fromkeys(use.reference for use in used[name])))
        images |= contexts.made
    yield from _circles(images, used)
    yield from _misspelt(images, used)
    return images


def read_dockerfile(text: str, image: Image) -> Dockerfile:
    """Reads the Dockerfile of an Image for this machine. Raises DockerfileError."""
    return _read(text, tuple(image.args.items()), image.target, image.platform)


@lru_cache(maxsize=512)
def _read(text: str, args: tuple[tuple[str, str], ...], target: str, wanted: str) -> Dockerfile:
    return read(text, dict(args), target, wanted, machine())


def machine() -> str:
    """The default platform of builds."""
    return MACHINES.get(platform.machine(), "linux/amd64")


def _declared(source: Source) -> Image:
    """The Image as its manifest declares it, with absolute directories."""
    spec: Any = source.spec
    return Image(
        source.name,
        str(real(source.directory / spec.context)) if spec.context is not None else None,
        spec.dockerfile,
        dict(spec.args),
        tuple(spec.import_) if spec.import_ else None,
        str(real(source.directory)),
        source.where("metadata", "name"),
        target=spec.target or "",
        platform=spec.platform or "",
    )


def _used(image: Image, source: Source, contexts: Contexts) -> Reading[tuple[Image, tuple[Use, ...]]]:
    """Returns what the stages that are built use."""
    path = _path(image)
    if image.context is None:
        return image, ()
    if not os.path.isfile(path):
        yield Diagnostic(source.where("spec", "context"), f"no {image.dockerfile} in {image.context}", "to create it")
        return image, ()
    try:
        text = read_text(path, Path(image.context), MOST)
        whole = read_dockerfile(text, replace(image, target=""))
        if image.target and image.target.lower() not in map(str.lower, whole.stages):
            yield _no_stage(image, source, whole)
            return image, ()
        uses = read_dockerfile(text, image).uses if image.target else whole.uses
    except OSError as error:
        yield Diagnostic(Where(str(path)), f"cannot be read: {error.strerror}", "to fix it")
    except DockerfileError as error:
        yield Diagnostic(Where(str(path), error.line), f"cannot be built: {error}", "to fix it")
    except Exception as bug:
        yield unexpected(Where(str(path)), bug)
    else:
        yield from _odd_arguments(image, source, whole)
        return (yield from stood_in(image, source, whole, uses, contexts))
    return image, ()


def _path(image: Image) -> Path:
    """The path of its Dockerfile."""
    return Path(image.context or "") / image.dockerfile


def _no_stage(image: Image, source: Source, file: Dockerfile) -> Diagnostic:
    where = source.where("spec", "target")
    remedy = nearest(image.target, {stage for stage in file.stages if stage}) or f"FROM ... AS {image.target}"
    return Diagnostic(where, f"{image.dockerfile} has no stage '{image.target}'", remedy)


def _odd_arguments(image: Image, source: Source, file: Dockerfile) -> Iterator[Diagnostic]:
    """Arguments without effect; Docker only warns about them."""
    for name in image.args:
        if name not in file.arguments and not PREDEFINED.fullmatch(name):
            where = source.where("spec", "args", name, key=True)
            message = f"{image.dockerfile} has no ARG {name}, so this changes nothing"
            yield Diagnostic(where, message, nearest(name, set(file.arguments)) or f"ARG {name} in it", "warning")


def _circles(images: Mapping[str, Image], used: Used) -> Iterator[Diagnostic]:
    """Reports Images that are based on themselves, directly or through others: they can never be built."""
    for cycle in cycles({name: [b for b in below if b in images] for name, below in stands_on(images).items()}):
        name, base = cycle[:2]
        line = next(use.line for use in used[name] if plain(use.reference) == base)
        remedy = "to break the cycle" if name != base else "another name for the Image"
        message = f"images stand on each other: {' -> '.join(cycle)}"
        yield Diagnostic(Where(str(_path(images[name])), line), message, remedy)


def _misspelt(images: Mapping[str, Image], used: Used) -> Iterator[Diagnostic]:
    """Reports unknown names that resemble an Image. A name without registry and tag is more likely a typo than an image
    on the hub."""
    for name, uses in used.items():
        for use in uses:
            reference = plain(use.reference)
            if reference in images or set(reference) & set("/:@"):
                continue
            if near := close_to(reference, images, ALIKE):
                where = Where(str(_path(images[name])), use.line)
                message = f"no Image is called '{reference}', so it is pulled"
                yield Diagnostic(where, message, f"'{near}'", "warning")
