"""How a state looks, in every picture and on the page (rorg/web/page): one colour, and a hatch that a grey print keeps.
A test compares the two."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from rorg.model.health import Health


class Look(NamedTuple):
    """Of a bar, or of the box of a service in a graph."""

    bar: str
    box: str
    edge: str
    hatch: str
    """As matplotlib writes it."""
    sign: str
    """Before the name in a graph."""


LOOKS = {
    "ready": Look("#116329", "#dafbe1", "#116329", "", "●"),
    "starting": Look("#fff8c5", "#fff8c5", "#7d4e00", "//", "◐"),
    "waiting": Look("#f6f8fa", "#f6f8fa", "#7d4e00", "..", "◌"),
    "idle": Look("#ddf4ff", "#ddf4ff", "#0550ae", "", "◫"),
    "stopped": Look("#f6f8fa", "#f6f8fa", "#59636e", "", "○"),
    "failing": Look("#a40e26", "#ffebe9", "#a40e26", "xx", "▲"),
    "unknown": Look("#fbefff", "#fbefff", "#6639ba", "..", "?"),
}
REQUEST = "#8250df"
OF_STATE = {
    "ready": "ready",
    "running": "starting",
    "restarting": "failing",
    "paused": "idle",
    "inactive": "idle",
    "created": "stopped",
    "exited": "stopped",
    "dead": "failing",
}
"""The look of a state in the journal. A service without a container has none."""


def look_of(service: Mapping[str, Any]) -> str:
    """How a service is, as the API shows it (ServiceView); "" for a person."""
    conditions = {c["type"]: c["status"] == "True" for c in service["conditions"]}
    state, wanted = service["state"], service["wanted"]
    if state == "meta":
        return ""
    if service["health"] == Health.DEGRADED or conditions.get("Stalled"):
        return "failing"
    if state == "unknown" or service["health"] == Health.UNKNOWN:
        return "unknown"
    if Health(service["health"]).kept_out:
        return "waiting"
    if state == "running":
        return "idle" if not wanted else "ready" if conditions.get("Ready") else "starting"
    return "idle" if state in ("paused", "inactive") else "starting" if wanted else "stopped"
