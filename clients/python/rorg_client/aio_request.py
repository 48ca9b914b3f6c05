"""A request held by an asyncio program, kept alive by a task."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Any, Callable, Generator, Sequence

from rorg_client import calls
from rorg_client.errors import Error, NotFound
from rorg_client.request import Kept, new_id, released, tell, unknown
from rorg_client.types import Loss, Readiness, RequestView

if TYPE_CHECKING:
    from rorg_client.aio import AsyncClient

PROMPT = 1.0
"""Seconds that a cancelled task waits for its release, which continues in any case."""


def looked_at(done: asyncio.Future[Any]) -> None:
    """Marks the exception of a task as seen."""
    if not done.cancelled():
        done.exception()


class AsyncRequest(Kept):
    """An asynchronous context manager; or awaited, and released explicitly."""

    def __init__(
        self,
        client: AsyncClient,
        services: Sequence[str],
        id: str | None,
        ttl: float | None,
        reason: str,
        priority: int | None,
        requester: str | None,
        wait: float | None,
        on_lost: Callable[[Loss], None] | None,
    ) -> None:
        super().__init__(services, id or new_id(services[0]), ttl, reason, priority, requester)
        self.client, self._wait = client, wait
        self._callbacks: list[Callable[[Loss], None]] = [on_lost] if on_lost else []
        self._lost: asyncio.Event | None = None
        self._sending: asyncio.Task[RequestView] | None = None
        """Its last sending: it must have arrived before the request can be released."""
        self._beat: asyncio.Task[None] | None = None
        self._waiting: set[asyncio.Future[dict[str, Readiness]]] = set()

    def __await__(self) -> Generator[object, None, AsyncRequest]:
        return self._begin().__await__()

    async def _begin(self) -> AsyncRequest:
        try:
            await self.put()
            if self._callbacks:
                self.client.watcher.add(self)
            if self._wait is not None:
                await self.wait(self._wait)
        except BaseException as error:
            if self.arrived or not isinstance(error, Error):
                await self._give_up()
            raise
        return self

    async def put(self) -> None:
        """Sends it, and keeps it alive from now on."""
        await self._send()
        self.arrived = True
        if self.ttl is not None and self._beat is None:
            self._beat = asyncio.ensure_future(self._heartbeat(self.ttl / 3))

    async def _send(self, patience: float | None = None) -> None:
        self._sending = asyncio.ensure_future(
            self.client.do(calls.put_request(self.id, self.body, self.requester), patience)
        )
        self._sending.add_done_callback(looked_at)
        await asyncio.shield(self._sending)

    async def _heartbeat(self, pause: float) -> None:
        timeout = min(pause, self.client.timeout)
        while True:
            await asyncio.sleep(pause)
            try:
                await self.client.do(calls.renew(self.id, self.requester), 0.0, timeout)
            except NotFound:
                with contextlib.suppress(Error):
                    await self._send(0.0)
                self.note(unknown(self.id))
            except Error:
                continue

    # -- readiness and loss ------------------------------------------------------------------------------------

    async def wait(self, timeout: float = 30.0) -> AsyncRequest:
        """Returns when its services and all that they need are ready; raises NotReady with what is missing, also if it
        is released meanwhile."""
        known = len(self.losses)
        waiting = asyncio.ensure_future(self.client.wait(*self.services, timeout=timeout))
        self._waiting.add(waiting)
        try:
            await asyncio.wait({waiting})
        finally:
            self._waiting.discard(waiting)
            waiting.cancel()
        if waiting.cancelled():
            raise released(self.id, self.services)
        lost = self.ready_now(waiting.result(), known)
        if self._lost is not None and not lost:
            self._lost.clear()
        return self

    def ready(self, timeout: float = 30.0) -> asyncio.Task[AsyncRequest]:
        """The same as a task."""
        return asyncio.ensure_future(self.wait(timeout))

    async def readiness(self) -> dict[str, Readiness]:
        """The current readiness of each of its services."""
        return await self.client.readiness(*self.services)

    @property
    def lost(self) -> asyncio.Event:
        """Set when a service that was ready is no longer; `losses` say which one and why. wait() clears it."""
        if self._lost is None:
            self._lost = asyncio.Event()
            if self.losses:
                self._lost.set()
            self.client.watcher.add(self)
        return self._lost

    def on_lost(self, call: Callable[[Loss], None]) -> None:
        """Registers a function that is called for every loss."""
        self._callbacks.append(call)
        self.client.watcher.add(self)

    def note(self, loss: Loss) -> None:
        """Records a loss."""
        if self.takes(loss):
            if self._lost is not None:
                self._lost.set()
            for call in list(self._callbacks):
                tell(call, loss)

    # -- the end -----------------------------------------------------------------------------------------------

    async def release(self) -> None:
        """Releases it, and continues if the task is cancelled meanwhile. If it fails, call it again."""
        if self.ours:
            await asyncio.shield(self._ending())

    def _ending(self) -> asyncio.Task[None]:
        for waiting in self._waiting:
            waiting.cancel()
        if self._beat is not None:
            self._beat.cancel()
        if self.client._watcher is not None:
            self.client._watcher.remove(self)
        task = asyncio.ensure_future(self._end())
        self.client.keep(task)
        return task

    async def _end(self) -> None:
        if self._sending is not None and not self._sending.done():
            await asyncio.wait({self._sending}, timeout=PROMPT)
            self._sending.cancel()
        await self.client.do(calls.release(self.id, self.requester))
        self._given_up = True

    async def _give_up(self) -> None:
        """Releases it after an error, without raising another: then the lease ends it."""
        if self.ours:
            task = self._ending()
            task.add_done_callback(looked_at)
            await asyncio.wait({task}, timeout=PROMPT)

    def abandon(self) -> None:
        """Stops keeping it without a release, because another request with the same id has replaced it."""
        self._given_up = True
        for waiting in self._waiting:
            waiting.cancel()
        if self._beat is not None:
            self._beat.cancel()
        if self.client._watcher is not None:
            self.client._watcher.remove(self)

    async def __aenter__(self) -> AsyncRequest:
        return await self._begin()

    async def __aexit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            await self.release()
        else:
            await self._give_up()
