"""What an engine says of itself in the header of its ping: its product, its version, and the API that rorg speaks with
it.

Docker 29 refuses clients below 1.44 and Docker 20.10 knows no more than 1.41, so there is no version that all engines
take. rorg asks for the newest that both know.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

NEWEST = (1, 45)
"""The newest version of the API that rorg is tested with (Docker 26). A later one may mean something else by the same
field."""
OLDEST = (1, 41)
"""Assumed of an engine that does not say (Docker 20.10, Podman 3 and later)."""
LOCAL = "localhost/"
"""Podman's prefix for images that were made here and name no registry."""
PRODUCTS: Mapping[str, str] = {"Libpod": "Podman"}
"""By the name that the engine's server has in its answers, if people know it by another name."""


class Release(NamedTuple):
    """One engine's release."""

    product: str = "Docker"
    version: str = ""
    """Empty if the engine does not say."""
    api: tuple[int, int] = OLDEST
    """The version of the API for all calls."""

    @property
    def podman(self) -> bool:
        return self.product == "Podman"

    def __str__(self) -> str:
        return f"{self.product} {self.version}".strip()


def release(headers: Mapping[str, str]) -> Release:
    """Read the headers of an answer to /_ping, by names in lower case: `Server: Docker/26.1.5 (linux)`, `Api-Version:
    1.45`."""
    name, _, rest = headers.get("server", "").partition("/")
    version = (rest.split() or [""])[0]
    said = re.fullmatch(r"(\d{1,4})\.(\d{1,4})", headers.get("api-version", ""))
    newest = (int(said[1]), int(said[2])) if said else OLDEST
    return Release(PRODUCTS.get(name, name or "Docker"), version, min(newest, NEWEST))


def version_text(api: tuple[int, int]) -> str:
    """A version of the API as URLs have it."""
    return f"{api[0]}.{api[1]}"
