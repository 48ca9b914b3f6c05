"""References of images, as people and engines write them: which ones mean the same, and which one an identity gives."""

from __future__ import annotations

import re
from collections.abc import Collection

HUB = ("docker.io/library/", "docker.io/", "index.docker.io/library/", "index.docker.io/")
"""What an engine puts before a name that says no registry."""
_PART = r"[a-z0-9]+(?:(?:\.|__?|-+)[a-z0-9]+)*"
NAME = rf"^(?:{_PART}:[0-9]{{1,5}}/)?{_PART}(?:/{_PART})*(?::[a-z0-9_][a-z0-9_.-]{{0,63}})?$"
"""Of an Image: a reference in small letters, without a digest."""
LONGEST = 200
"""Characters of a name; an engine takes 255, and rorg puts an identity behind it."""
SHORT = 12
"""Digits of an identity in a tag."""


def plain(reference: str) -> str:
    """The shortest form that means the same to an engine: "docker.io/library/base:latest" is "base"."""
    for prefix in HUB:
        if reference.startswith(prefix):
            reference = reference.removeprefix(prefix)
            break
    return reference.removesuffix(":latest")


def declared(reference: str, names: Collection[str]) -> str:
    """Which of these Images a reference means; empty where it is none of them."""
    found = plain(reference)
    return found if found in names else ""


def with_identity(name: str, identity: str) -> str:
    """The reference that means this content for ever: "base" is "base:0123456789ab", "lab/base:2" is
    "lab/base:2-0123456789ab"."""
    short = identity[:SHORT]
    return f"{name}-{short}" if ":" in name.rpartition("/")[2] else f"{name}:{short}"


def check_name(name: str) -> None:
    """Raises ValueError for what an Image cannot be called: no reference of an engine, or a longer form of one."""
    if not re.fullmatch(NAME, name) or len(name) > LONGEST:
        raise ValueError(f"'{name}' cannot name an image; write small letters: base, lab/base or lab/base:1.2")
    if plain(name) != name:
        raise ValueError(f"'{name}' means the same as '{plain(name)}'; write '{plain(name)}'")


def stem(name: str) -> str:
    """What the file is called that declares this name, without its ending."""
    return re.sub(r"[/:]", "-", name)


def stems(name: str) -> set[str]:
    """What it may be called as well: the last part alone, with or without the tag, and _ for -."""
    last = name.rpartition("/")[2]
    return {re.sub(r"[/:]", sign, part) for part in (name, last, last.partition(":")[0]) for sign in "-_"}
