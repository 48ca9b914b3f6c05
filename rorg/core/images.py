"""Why no container is made from an image now."""

from __future__ import annotations

from collections.abc import Collection

from rorg.core.plan import Waiting
from rorg.core.view import View
from rorg.model.catalog import Service
from rorg.model.codes import IMAGE, NO_IMAGE


def held_back(view: View, service: Service, changed: Collection[str], runs: bool) -> Waiting | None:
    """Why the container that is desired is not made now, for want of its image or since the Policy leaves the one
    before in use; None where nothing stands against it. `changed`: options that are not as in the container that is
    there; `runs`: that one is active."""
    image = str((service.spec or {}).get("image", ""))
    missing = view.s.images.get(image)
    if missing:
        return Waiting(service.name, f"image {image} {missing.reason}", code=NO_IMAGE if missing.failed else IMAGE)
    s, later = view.s, view.desired.catalog.policy.images.update == "when_ceased"
    if later and runs and set(changed) == {"image"} and service.name in s.wanted and service.name not in s.restarts:
        return Waiting(service.name, f"image {image} comes into use when it is next ceased", code="deferred")
    return None
