"""How long what a trace requests takes to be ready."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rorg.model.catalog import Catalog
from rorg.model.graph import closure
from rorg.model.trace import TraceEvent
from rorg.sim.results import Response


class Responses:
    """One for each event that requests something, in their order."""

    def __init__(self, catalog: Catalog) -> None:
        self.catalog = catalog
        self.found: list[Response] = []
        self._open: dict[tuple[str, str], tuple[int, frozenset[str]]] = {}
        """By request: its place in `found`, and services that must be ready."""

    def asked(self, event: TraceEvent) -> None:
        """A request is made, in place of the one of the same requester and id, or given up."""
        key = event.requester, event.id
        self._open.pop(key, None)
        if event.services:
            members = (member for name in event.services for member in self.catalog.members(name))
            names = frozenset(n for n in closure(self.catalog.services, members) if not self.catalog.services[n].meta)
            self._open[key] = len(self.found), names
            self.found.append(Response(event.at, event.requester, event.id, event.state, None))

    def look(self, ready: Callable[[str], bool], now: float) -> None:
        """Takes note of what is ready: all of a request at the same time."""
        for key, (index, names) in list(self._open.items()):
            if all(map(ready, names)):
                del self._open[key]
                self.found[index] = replace(self.found[index], seconds=now - self.found[index].at)
