"""Reads that know of a change: held back until the loop has acted on it; and the answers of an rorg that ends."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any
from urllib.parse import parse_qs

from rorg.api.operations import Operations
from rorg.api.problems import answer
from rorg.errors import Busy, Invalid, RorgError

HEADER = b"rorg-not-before"
GENERATION = "rorg-generation"
"""The header in which a change answers with its generation."""
PATIENCE = 10.0
"""Seconds that a call is held back at the most."""


class NotBefore:
    """In front of the application. A caller names the generation of its last change in a header, or in the query; no
    answer that does not know of that change is given. While rorg is being stopped every call is told to come again."""

    def __init__(self, app: Any, operations: Operations, changed: Callable[[], asyncio.Event]) -> None:
        self.app, self.operations, self.changed = app, operations, changed

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        try:
            generation = self._asked(scope)
            if not self.operations.open_to(generation):
                await reached(self.operations, generation, self.changed)
        except RorgError as error:
            await answer(error)(scope, receive, send)
        else:
            await self.app(scope, receive, send)

    def _asked(self, scope: Any) -> int:
        """The list of requests is never older than the question: who releases looks there first."""
        lists = scope.get("method") == "GET" and scope.get("path") == "/v1/requests"
        return max(_named(scope), self.operations.loop.generations.latest if lists else 0)


async def reached(operations: Operations, generation: int, changed: Callable[[], asyncio.Event]) -> None:
    """Returns when the loop has acted on a generation. Raises Busy when that takes too long."""
    end = asyncio.get_running_loop().time() + PATIENCE
    while not operations.open_to(generation):
        event = changed()
        left = end - asyncio.get_running_loop().time()
        if operations.open_to(generation):
            return
        if left <= 0:
            raise Busy(
                "answer",
                f"change {generation} has not been acted on in {PATIENCE:g} s; the manifests are "
                "being written, or the loop is held up",
                "again in a moment",
            )
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(event.wait(), left)


def _named(scope: Any) -> int:
    """The generation that a call names; 0 without one."""
    text = next((value for name, value in scope.get("headers", ()) if name == HEADER), b"").decode("latin-1")
    if not text and b"not_before" in scope.get("query_string", b""):
        text = parse_qs(scope["query_string"].decode("latin-1")).get("not_before", [""])[-1]
    if not text:
        return 0
    if not text.isascii() or not text.isdigit() or len(text) > 18:
        raise Invalid(
            "read the request",
            f"not before '{text[:40]}': a generation is a whole number",
            "the number that a change was answered with",
        )
    return int(text)
