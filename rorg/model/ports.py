"""Ports as manifests declare them: `ports` and `expose`, in Compose's short form."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass

HIGHEST = 65535


@dataclass(frozen=True, slots=True)
class Published:
    """One port of the container, and where it is reached. `host` is "" for any free port, or a range to choose from."""

    port: str
    """Such as 80/tcp."""
    address: str
    host: str


def parse_ports(text: str) -> list[Published]:
    """Parses [ADDRESS:][HOST:]CONTAINER[/PROTOCOL]. HOST and CONTAINER may be ranges of equal length; a range of hosts
    for a single container port means any free one of them."""
    head, _, inside = text.rpartition(":")
    address, _, outside = head.rpartition(":")
    first, last, protocol = _inside(text, inside)
    address = _address(text, address)
    if not outside:
        return [Published(f"{n}/{protocol}", address, "") for n in range(first, last + 1)]
    low, high = _range(text, outside, 0)
    if first == last and low != high:
        return [Published(f"{first}/{protocol}", address, f"{low}-{high}")]
    if high - low != last - first:
        raise ValueError(f"'{text}' has ranges of different length")
    return [Published(f"{first + n}/{protocol}", address, str(low + n)) for n in range(last - first + 1)]


def parse_expose(text: str) -> list[str]:
    """Parses PORT or RANGE, with /PROTOCOL, to the engine's form: 80/tcp."""
    first, last, protocol = _inside(text, text)
    return [f"{n}/{protocol}" for n in range(first, last + 1)]


def check_target(text: str) -> None:
    """Raises ValueError unless the text is a container port or a range of them."""
    _range(text, text, 1)


def check_published(text: str) -> None:
    """Raises ValueError unless the text is a host port or a range; 0 is any free port."""
    _range(text, text, 0)


def _inside(text: str, part: str) -> tuple[int, int, str]:
    ports, slash, protocol = part.partition("/")
    if slash and protocol.lower() not in ("tcp", "udp", "sctp"):
        raise ValueError(f"'{text}' has no protocol that is known; write tcp, udp or sctp")
    return *_range(text, ports, 1), protocol.lower() or "tcp"


def _range(text: str, part: str, least: int) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,5})(?:-([0-9]{1,5}))?", part, re.ASCII)
    if not match:
        raise ValueError(f"'{text}' is not a port; write HOST:CONTAINER, such as 8080:80, or ranges of both")
    low, high = int(match[1]), int(match[2] or match[1])
    if not least <= low <= high <= HIGHEST:
        raise ValueError(
            f"'{text}' has a port that is not between {least} and {HIGHEST}, or a range that ends before it begins"
        )
    return low, high


def _address(text: str, part: str) -> str:
    if not part:
        return ""
    bare = part[1:-1] if part.startswith("[") and part.endswith("]") else part
    try:
        ipaddress.ip_address(bare)
    except ValueError:
        raise ValueError(f"'{text}' has no address that can be listened on; write an IP address") from None
    return bare
