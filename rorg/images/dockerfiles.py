"""The Dockerfile of an order, as the engine gets it."""

from __future__ import annotations

from pathlib import Path

from rorg.errors import EngineError
from rorg.images.order import Order
from rorg.manifest.dockerfile import DockerfileError, rewritten
from rorg.manifest.files import read_bytes
from rorg.manifest.images import machine, read_dockerfile
from rorg.model.catalog import Image


def dockerfile_of(order: Order, image: Image, buildkit: bool) -> bytes:
    """Its text, with the references that are in force. Raises OSError where it cannot be read, and EngineError where it
    makes no sense or needs BuildKit and there is none."""
    if image.inline:
        return image.inline.encode()
    context = Path(image.context or "")
    # Whatever it is, it is turned back.
    text = read_bytes(context / image.dockerfile, context).decode(errors="surrogateescape")
    try:
        if not buildkit and read_dockerfile(text, image).buildkit:
            remedy = "installing the docker command with buildx (Debian's docker.io has it), and an engine of Docker's"
            raise EngineError(f"build {image.name}", f"{image.dockerfile} needs BuildKit, which is not here", remedy)
        now = order.replacements
        stand_ins = {name: now.get(reference, reference) for name, reference in image.stand_ins.items()}
        found = rewritten(text, image.args, {**now, **stand_ins}, image.target, image.platform, machine())
    except DockerfileError as error:
        raise EngineError(f"build {image.name}", f"{image.dockerfile}:{error.line}: {error}") from error
    return found.encode(errors="surrogateescape")
