"""Why no container is made now."""

from __future__ import annotations

from collections.abc import Collection

from rorg.core.deferred import deferred
from rorg.core.plan import Waiting
from rorg.core.view import View
from rorg.model.catalog import Service
from rorg.model.codes import DEVICE, IMAGE, NO_IMAGE


def held_back(view: View, service: Service, changed: Collection[str]) -> Waiting | None:
    """Why the container that is desired is not made now, for want of a device or of its image, or since its change is
    left for later; None where nothing stands against it. `changed`: options that are not as in the container
    that is there."""
    if service.name in view.s.unplugged:
        return Waiting(service.name, view.s.unplugged[service.name], code=DEVICE)
    image = str((service.spec or {}).get("image", ""))
    missing = view.s.images.get(image)
    if missing:
        return Waiting(service.name, f"image {image} {missing.reason}", code=NO_IMAGE if missing.failed else IMAGE)
    return deferred(view, service, changed)
