"""Reasons not to create a container now: a missing device, a missing image, or a deferred change."""

from __future__ import annotations

from collections.abc import Collection

from rorg.core.deferred import deferred
from rorg.core.plan import Waiting
from rorg.core.view import View
from rorg.model.catalog import Service
from rorg.model.codes import DEVICE, IMAGE, NO_IMAGE


def held_back(view: View, service: Service, changed: Collection[str]) -> Waiting | None:
    """Return why the desired container is not created now; None if nothing prevents it. `changed` are options in which
    the existing container differs."""
    if service.name in view.s.unplugged:
        return Waiting(service.name, view.s.unplugged[service.name], code=DEVICE)
    image = str((service.spec or {}).get("image", ""))
    missing = view.s.images.get(image)
    if missing:
        return Waiting(service.name, f"image {image} {missing.reason}", code=NO_IMAGE if missing.failed else IMAGE)
    return deferred(view, service, changed)
