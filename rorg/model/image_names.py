"""References of images: which ones mean the same, and the reference for an identity."""

from __future__ import annotations

import re
from collections.abc import Collection

HUB = ("docker.io/library/", "docker.io/", "index.docker.io/library/", "index.docker.io/")
"""Prefixes that an engine adds to a name without a registry."""
_PART = r"[a-z0-9]+(?:(?:\.|__?|-+)[a-z0-9]+)*"
NAME = rf"^(?:{_PART}:[0-9]{{1,5}}/)?{_PART}(?:/{_PART})*(?::[a-z0-9_][a-z0-9_.-]{{0,63}})?$"
"""Name of an Image: a reference in small letters, without a digest."""
LONGEST = 200
"""Characters of a name; an engine accepts 255, and rorg appends an identity."""
SHORT = 12
"""Digits of an identity in a tag."""


def plain(reference: str) -> str:
    """The shortest equivalent form: "docker.io/library/base:latest" is "base"."""
    return without_hub(reference).removesuffix(":latest")


def without_hub(reference: str) -> str:
    """As Docker shows it; Podman shows the registry too."""
    prefix = next((prefix for prefix in HUB if reference.startswith(prefix)), "")
    return reference.removeprefix(prefix)


def declared(reference: str, names: Collection[str]) -> str:
    """The Image that a reference means; empty if it is none of them."""
    name = plain(reference)
    return name if name in names else ""


def with_identity(name: str, identity: str) -> str:
    """The reference that always means this content: "base" becomes "base:0123456789ab", "lab/base:2" becomes
    "lab/base:2-0123456789ab"."""
    short = identity[:SHORT]
    return f"{name}-{short}" if ":" in name.rpartition("/")[2] else f"{name}:{short}"


def check_name(name: str) -> None:
    """Raises ValueError for an invalid name of an Image: not a reference, or not the shortest form of one."""
    if not re.fullmatch(NAME, name) or len(name) > LONGEST:
        raise ValueError(f"'{name}' cannot name an image; write small letters: base, lab/base or lab/base:1.2")
    if plain(name) != name:
        raise ValueError(f"'{name}' means the same as '{plain(name)}'; write '{plain(name)}'")


def stem(name: str) -> str:
    """The name of the file that declares this name, without its ending."""
    return re.sub(r"[/:]", "-", name)


def stems(name: str) -> set[str]:
    """Other accepted names of that file: the last part alone, with or without the tag, and _ for -."""
    last = name.rpartition("/")[2]
    return {re.sub(r"[/:]", sign, part) for part in (name, last, last.partition(":")[0]) for sign in "-_"}
