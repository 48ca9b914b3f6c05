"""Clients read their own writes: answers wait until the loop has acted on the change that the caller knows of.

Every change is answered with a generation. A caller names the newest one that it knows in the header `rorg-not-before`,
or in the query as `not_before`. While rorg stops, every call gets "busy", so that clients try again.
"""

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
"""Longest time, in seconds, that a call waits for the loop."""


class NotBefore:
    """The ASGI application that holds calls back, in front of another."""

    def __init__(self, app: Any, operations: Operations) -> None:
        self.app, self.operations = app, operations

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        try:
            generation = _named(scope)
            if scope.get("method") == "GET" and scope.get("path") == "/v1/requests":
                # The list of requests is never older than the question: callers look there before they release.
                generation = max(generation, self.operations.latest)
            if not self.operations.open_to(generation):
                await reached(self.operations, generation)
        except RorgError as error:
            await answer(error)(scope, receive, send)
        else:
            await self.app(scope, receive, send)


async def until(operations: Operations, done: Callable[[], bool], seconds: float) -> bool:
    """Waits until `done()`, which is asked after each pass of the loop; False if the time runs out first."""
    clock = asyncio.get_running_loop().time
    end = clock() + seconds
    while True:
        event = operations.next_pass()  # taken first: a pass that ends during the check sets it
        if done():
            return True
        if clock() >= end:
            return False
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(event.wait(), end - clock())


async def reached(operations: Operations, generation: int) -> None:
    """Waits until the loop has acted on a generation. Raises Busy if that takes longer than PATIENCE."""
    if not await until(operations, lambda: operations.open_to(generation), PATIENCE):
        why = "the manifests are being written, or the loop is held up"
        raise Busy("answer", f"change {generation} has not been acted on in {PATIENCE:g} s; {why}", "again in a moment")


def _named(scope: Any) -> int:
    """The generation that a call names; 0 if it names none. Raises Invalid."""
    text = next((value for name, value in scope.get("headers", ()) if name == HEADER), b"").decode("latin-1")
    if not text and b"not_before" in scope.get("query_string", b""):
        text = parse_qs(scope["query_string"].decode("latin-1")).get("not_before", [""])[-1]
    if not text:
        return 0
    if not text.isascii() or not text.isdigit() or len(text) > 18:
        why = f"not before '{text[:40]}': a generation is a whole number"
        raise Invalid("read the request", why, "the number that a change was answered with")
    return int(text)
