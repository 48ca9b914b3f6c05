"""Builds with the classic builder, which every engine has, through the engine's API."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rorg.engines.docker.answers import from_json
from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import docker_errors
from rorg.errors import EngineError
from rorg.images.cancel import Cancellation
from rorg.images.context import write_tar
from rorg.images.order import Order, Say, StepFailed
from rorg.model.catalog import Image

STEP = re.compile("step ", re.IGNORECASE)
"""The beginning of a message about the next step: `Step 1/3 : FROM ...`, with Podman `STEP 1/3: FROM ...`."""


def build(client: Client, order: Order, image: Image, dockerfile: bytes, say: Say, cancellation: Cancellation) -> str:
    """The id of the image. `dockerfile`: its text after rewriting. Raises StepFailed, and OSError for unreadable files
    of the context."""
    with tempfile.TemporaryFile(prefix="rorg-build-") as tar:
        name = write_tar(Path(image.context or ""), image.dockerfile, dockerfile, tar)
        tar.seek(0)
        query = query_of(order, image, name)
        with (
            docker_errors(f"build {order.name}"),
            cancellation.by(tar.close),
            client.stream("POST", "/build", tar, **query) as stream,
            cancellation.by(stream.close),
        ):
            return _read(order, stream.lines(), say)


def query_of(order: Order, image: Image, dockerfile: str) -> dict[str, Any]:
    """The parameters of the request. `dockerfile`: its name in the context."""
    return {
        "t": order.reference,
        "dockerfile": dockerfile,
        "buildargs": dict(image.args),
        "labels": dict(order.labels),
        "networkmode": "host",
        "nocache": not order.cache,
        "rm": True,
        "forcerm": True,
        "target": image.target or None,
        "platform": image.platform or None,
        # If other images are named, this builder does not look at its own.
        "cachefrom": json.dumps([*image.cache_from, image.name]) if image.cache_from else None,
    }


def _read(order: Order, lines: Iterable[bytes], say: Say) -> str:
    """Passes on the engine's messages about a build; the id of the image."""
    what, step, made = f"build {order.name}", "", ""
    for line in lines:
        told = from_json(line)
        text = str(told.get("stream", ""))
        if "error" in told:
            raise StepFailed(what, str(told["error"]), step)
        begins = STEP.match(text) is not None
        if begins:
            step = text.strip()
        if text:
            say(text, step=begins)
        if "aux" in told:
            made = str(told["aux"].get("ID", made))
    if not made:
        raise EngineError(what, "the engine closed the connection before the build had ended")
    return made
