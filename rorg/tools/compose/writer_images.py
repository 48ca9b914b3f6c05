"""Images of a robot as `build` sections of a Compose file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rorg.manifest.build_contexts import FILES
from rorg.model.catalog import Catalog, Image, Service
from rorg.model.image_names import declared
from rorg.tools.compose.writer_options import beside


def build(image: Image, images: Mapping[str, Image], base: str) -> dict[str, Any]:
    """How Compose builds an image. `base`: absolute directory of the Compose file. A secret argument has no value in
    the file; Compose takes it from its environment."""
    options: dict[str, Any] = {"context": beside(image.context or ".", base)}
    if image.inline:
        options["dockerfile_inline"] = image.inline
    elif image.dockerfile != "Dockerfile":
        options["dockerfile"] = image.dockerfile
    if image.args:
        options["args"] = {k: None if k in image.secrets else v for k, v in sorted(image.args.items())}
    if image.target:
        options["target"] = image.target
    if image.platform:
        options["platforms"] = [image.platform]
    if image.cache_from:
        options["cache_from"] = list(image.cache_from)
    if image.stand_ins:
        contexts = {name: _context(value, images, base) for name, value in sorted(image.stand_ins.items())}
        options["additional_contexts"] = contexts
    return options


def _context(reference: str, images: Mapping[str, Image], base: str) -> str:
    """What a name in a Dockerfile refers to: a directory, or an image."""
    image = images.get(declared(reference, images))
    if image is not None and is_directory(image):
        return beside(image.context or ".", base)
    return f"docker-image://{reference}"


def is_directory(image: Image) -> bool:
    """Whether it contains just the files of a directory: rorg's form of an additional context."""
    return image.inline == FILES


def base_images(catalog: Catalog, services: Mapping[str, Service]) -> Iterator[Image]:
    """Images that are built only because other images need them."""
    used = {declared(str(s.options["image"]), catalog.images) for s in services.values()}
    for name, image in sorted(catalog.images.items()):
        if name not in used and image.context is not None and not is_directory(image):
            yield image
