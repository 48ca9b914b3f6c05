"""The client of rorg is a package of its own, rorg_client (clients/python); this is its former name."""

from __future__ import annotations

from typing import Any

import rorg_client
from rorg_client import *  # noqa: F403
from rorg_client import __all__ as __all__


def __getattr__(name: str) -> Any:
    return getattr(rorg_client, name)
