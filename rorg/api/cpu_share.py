"""What calls cost, in front of the application: a caller that has used up its share gets 429 with the time to wait."""

from __future__ import annotations

import asyncio
import math
import types
from collections.abc import Coroutine, Generator
from typing import Any

from rorg.api import limits
from rorg.api.connection import CPU
from rorg.api.limits import Account
from rorg.api.operations import Operations
from rorg.api.problems import answer
from rorg.errors import TooMany

THREADS = (
    "/metrics",
    "/v1/manifests",
    "/v1/diff",
    "/v1/preview",
    "/v1/usage",
    "/v1/listeners",
    "/v1/connections",
    "/v1/history",
    "/v1/rollback",
    "/v1/timeline",
    "/v1/requested",
    "/v1/measured",
)
"""Calls that work in threads of their own: a service gets one at a time, charged by its time."""


class Metered:
    """The ASGI application that charges each step of a service's call in the server's thread to its account. While the
    account owes, work under way waits and new calls are refused."""

    def __init__(self, app: Any, operations: Operations) -> None:
        self.app, self.operations = app, operations

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        account: Account = scope["state"]["account"]
        if not account.limited:
            await self.app(scope, receive, send)
            return
        account.charge(limits.CALL)
        try:
            self._admit(account)
            with account.reading(_length(scope)):
                await paced(self._one(scope, receive, send), account)
        except TooMany as error:
            await answer(error)(scope, receive, send)

    def _admit(self, account: Account) -> None:
        if owed := account.owed():
            told = f"{account.name} uses more than its share of rorg and has to wait"
            self.operations.recorder.when_new(f"share of {account.name}", True, "too-many-requests", told)
            raise TooMany(
                "answer",
                f"{account.name} has used up its share of rorg, {limits.SHARE:.0%} of a CPU",
                f"again in {owed:.1f} s, and less often",
                math.ceil(owed),
            )

    async def _one(self, scope: Any, receive: Any, send: Any) -> None:
        account: Account = scope["state"]["account"]
        account.charge(_price(scope))
        if not in_threads(scope["path"]):
            await self.app(scope, receive, send)
            return
        async with account.threads:
            clock = asyncio.get_running_loop().time
            began = clock()
            try:
                await self.app(scope, receive, send)
            finally:
                account.charge(clock() - began)


def in_threads(path: str) -> bool:
    """Whether a call works in a thread of its own."""
    return path.startswith(THREADS) or path.endswith(("/description", "/renewal"))


def _price(scope: Any) -> float:
    """CPU seconds that a call costs elsewhere: renewals stay in memory, every other change is written to the disk."""
    waits = scope["path"] == "/v1/wait" or b"wait=" in scope["query_string"]
    if scope["method"] == "GET":
        return limits.WAIT if waits else 0.0
    return 0.0 if scope["path"].endswith("/renew") else limits.CHANGE + waits * limits.WAIT


def _length(scope: Any) -> int:
    """Bytes of the body that a call declares; a missing or too large number is refused later."""
    text = next((value for name, value in scope["headers"] if name == b"content-length"), b"0")
    return min(int(text), limits.MOST_BODY) if text.isdigit() and len(text) < 10 else 0


@types.coroutine
def paced(work: Coroutine[Any, Any, None], account: Account) -> Generator[Any, Any, None]:
    """Runs a coroutine and charges each of its steps to an account; while that owes, the next step waits."""
    step, value = work.send, None
    while True:
        began = CPU()
        try:
            awaited = step(value)
        except StopIteration:
            return
        finally:
            account.charge(CPU() - began)
        try:
            value, step = (yield awaited), work.send
            while owed := account.owed():
                yield from asyncio.sleep(owed)
        except BaseException as error:  # such as CancelledError, which the coroutine must see
            value, step = error, work.throw
