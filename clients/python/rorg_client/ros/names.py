"""Names of nodes, and the ids and addresses of what they request."""

from __future__ import annotations

import hashlib
import re
from urllib.parse import quote

PASSING = re.compile(r"_[0-9]+_[0-9]{10,}$|_[0-9]{16,}$")
"""The end of the name that rospy or roscpp gives to an anonymous node."""
HAND = re.compile(r"^/(rosservice_[0-9_]+|_ros2cli_[0-9_]+)$")
"""Tools that are gone after one call: all of them are one caller, who can release what he requested."""


def passing(node: str) -> bool:
    """Whether a node has no fixed name, so that it may be gone after one call."""
    return PASSING.search(node) is not None


def holder_of(caller: str) -> str:
    """Who holds what a node requests: the node itself; all people who call by hand, even without a name, are one
    holder."""
    return "/rosservice" if not caller or HAND.match(caller) else caller


def tag(holder: str) -> str:
    """A node's name as a part of an id, different for every name."""
    text = holder.strip("/").replace("/", ".")
    plain = re.fullmatch(r"[A-Za-z0-9_.]{1,40}", text) and "." not in holder
    return text if plain else f"{re.sub('[^A-Za-z0-9_.]', '.', text)[:27]}-{digest(holder)}"


def request_id(kind: str, holder: str, id: str) -> str:
    """An id that rorg accepts, from any caller's name and id, different for every pair."""
    id, room = id or "request", 64 - len(f"{kind}:{tag(holder)}:")
    plain = re.fullmatch(r"[A-Za-z0-9_.:-]+", id) and len(id) <= room and not re.search("-[0-9a-f]{8}$", id)
    if not plain:
        id = f"{re.sub('[^A-Za-z0-9_.:-]', '.', id)[: room - 9]}-{digest(id)}"
    return f"{kind}:{tag(holder)}:{id}"


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def address(key: str, requester: str, more: str = "") -> str:
    return f"/v1/requests/{quote(key, safe='')}{more}" + (f"?requester={quote(requester)}" if requester else "")


def manifest(kind: str, name: str) -> str:
    return f"/v1/manifests/{quote(kind or 'Service', safe='')}/{quote(name, safe='')}"


def format_seconds(value: float) -> str:
    return f"{value:.3f}".rstrip("0").rstrip(".") + "s"
