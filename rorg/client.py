"""The former name of the client, which is a package of its own: rorg_client (clients/python)."""

from __future__ import annotations

from typing import Any

import rorg_client
from rorg_client import PATIENCE as PATIENCE
from rorg_client import TTL as TTL
from rorg_client import Client as Client
from rorg_client import Error as Error
from rorg_client import Forbidden as Forbidden
from rorg_client import Invalid as Invalid
from rorg_client import NotFound as NotFound
from rorg_client import NotReady as NotReady
from rorg_client import Refused as Refused
from rorg_client import Request as Request
from rorg_client import Unreachable as Unreachable
from rorg_client import check_id as check_id
from rorg_client import client as client
from rorg_client import request as request


def __getattr__(name: str) -> Any:
    """Import everything else, such as AsyncClient, when it is used."""
    return getattr(rorg_client, name)
