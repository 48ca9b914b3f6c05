"""The lines of the journal that a requester may see: about its own requests and what they name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rorg.model.catalog import Catalog, Request
from rorg.model.graph import closure


def own_events(
    entries: Iterable[Mapping[str, Any]], requester: str, catalog: Catalog, requests: Iterable[Request]
) -> list[dict[str, Any]]:
    """Those of `entries` that are about the requester, what its `requests` name, or what that needs. Of `requests` that
    a line names, only its own are told, by their ids."""
    named = {s for r in requests if r.requester == requester for s in r.services}
    services = {requester, *named, *closure(catalog.services, [m for s in named for m in catalog.members(s)])}
    found = []
    for entry in entries:
        mine = [text.partition("/")[2] for text in entry.get("requests", ()) if text.startswith(f"{requester}/")]
        about = {entry.get("service"), *entry.get("services", ()), *entry.get("shed", ())}
        if mine or about & services:
            found.append({**entry, "requests": mine} if "requests" in entry else dict(entry))
    return found
