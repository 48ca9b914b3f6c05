"""A task that follows what happens to the requests of an asyncio client, and tells those that lose something."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rorg_client import calls
from rorg_client.aio_connection import AsyncConnection, events_of
from rorg_client.errors import Error, Forbidden, Invalid, NotFound
from rorg_client.types import Loss
from rorg_client.watch import LATELY, PAUSE, loss_of, losses_of, lost_meanwhile

if TYPE_CHECKING:
    from rorg_client.aio import AsyncClient
    from rorg_client.aio_request import AsyncRequest


class AsyncWatcher:
    """Runs while there are requests to watch."""

    def __init__(self, client: AsyncClient) -> None:
        self._client = client
        self._requests: list[AsyncRequest] = []
        self._tasks: dict[str | None, asyncio.Task[None]] = {}
        """By requester."""

    def add(self, request: AsyncRequest) -> None:
        if request not in self._requests and request.ours:
            self._requests.append(request)
            if request.requester not in self._tasks:
                self._tasks[request.requester] = asyncio.ensure_future(self._run(request.requester))

    def remove(self, request: AsyncRequest) -> None:
        if request in self._requests:
            self._requests.remove(request)
            if not self._of(request.requester):
                self._tasks.pop(request.requester).cancel()

    def _of(self, requester: str | None) -> list[AsyncRequest]:
        return [r for r in self._requests if r.requester == requester]

    async def _run(self, requester: str | None) -> None:
        cursor: int | None = None
        while True:
            pause = PAUSE
            try:
                connection = await AsyncConnection.open(self._client.address, self._client.timeout)
                try:
                    async for event in events_of(connection, calls.events(cursor, True, 0, True, requester)):
                        if "kind" not in event:
                            await self._look(requester)
                        for request in self._of(requester) if "kind" in event else []:
                            loss = loss_of(event, request)
                            if loss:
                                request.note(loss)
                        cursor = event["seq"]
                finally:
                    connection.close()
            except (Forbidden, Invalid):
                pause = 10 * PAUSE  # an rorg that does not report losses; another may replace it
            except (OSError, Error, ValueError):
                pass
            await asyncio.sleep(pause)

    async def _look(self, requester: str | None) -> None:
        """Finds losses from a time when the stream was not followed."""
        for request in self._of(requester):
            for name, run in list(request.runs.items()):
                try:
                    loss = lost_meanwhile(name, run, await self._client.service(name))
                except NotFound:
                    loss = Loss(name, "ceased", f"{name} is no longer declared", run)
                if loss:
                    only = losses_of(name)
                    async for event in self._client.events(tail=LATELY, mine=True, requester=requester, only=only):
                        loss = loss_of(event, request) or loss
                    request.runs.pop(name, None)
                    request.note(loss)
