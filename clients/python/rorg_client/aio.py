"""The client for asyncio: on streams, without a thread. `async with client.request("navigation", wait=30):`"""

from __future__ import annotations

import asyncio
import os
import time
from typing import Any, AsyncIterator, Callable, Mapping, TypeVar

from rorg_client import calls
from rorg_client.address import Address
from rorg_client.aio_connection import AsyncConnection, events_of
from rorg_client.aio_request import AsyncRequest
from rorg_client.aio_watch import AsyncWatcher
from rorg_client.calls import PATIENCE, TTL, Attempts, Call, Failed, Newest
from rorg_client.client import RESTART_PAUSE
from rorg_client.errors import Error, NotReady, Unreachable, unreachable
from rorg_client.names import check_id, check_names
from rorg_client.readiness import not_restarted, readiness_of
from rorg_client.types import (
    Event,
    GroupView,
    Loss,
    ManifestView,
    Readiness,
    RequestView,
    ServiceView,
    Spec,
    Usage,
    Why,
)
from rorg_client.wire import Answer, asking, reading

__all__ = ["AsyncClient", "AsyncRequest"]

T = TypeVar("T")


class AsyncClient:
    """Like Client, for one event loop at a time. Each call under way has its own connection, so that a waiting call
    delays no other; a cancelled call closes its connection."""

    def __init__(
        self,
        address: str | None = None,
        timeout: float = 10.0,
        patience: float = PATIENCE,
        *,
        ca: str = "",
        cert: str = "",
        key: str = "",
    ) -> None:
        self.address, self.timeout, self.patience = Address(address or "", ca, cert, key), timeout, patience
        self._newest = Newest()
        self._idle: list[AsyncConnection] = []
        self._home: tuple[int, asyncio.AbstractEventLoop | None] = (0, None)
        """The process and event loop of the idle connections."""
        self._watcher: AsyncWatcher | None = None
        self._tasks: set[asyncio.Future[Any]] = set()
        """Tasks that continue without a caller waiting for them."""

    async def close(self) -> None:
        """Closes idle connections; the next call opens another."""
        for connection in self._at_home():
            connection.close()
        self._idle = []

    def _at_home(self) -> list[AsyncConnection]:
        """The idle connections of this process and event loop."""
        home = (os.getpid(), asyncio.get_running_loop())
        if self._home != home:
            self._home, self._idle, self._watcher = home, [], None
        return self._idle

    def keep(self, task: asyncio.Future[Any]) -> None:
        """Lets a task run to its end."""
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # -- requests ----------------------------------------------------------------------------------------------

    def request(
        self,
        *services: str,
        id: str | None = None,
        wait: float | None = None,
        ttl: float | None = TTL,
        reason: str = "",
        priority: int | None = None,
        requester: str | None = None,
        on_lost: Callable[[Loss], None] | None = None,
    ) -> AsyncRequest:
        """Like Client.request: `async with client.request(...)`, or `held = await client.request(...)`. If its task is
        cancelled while it waits, the request is released immediately."""
        check_names("request", services)
        check_id(id or "request")
        return AsyncRequest(self, services, id, ttl, reason, priority, requester, wait, on_lost)

    async def wait(self, *services: str, timeout: float = 30.0) -> dict[str, Readiness]:
        """Returns the readiness of each service when they and all that they need are ready; raises NotReady with what
        is missing."""
        told = await self.do(calls.wait(services, timeout))
        found: dict[str, Readiness] | None = told.get("services")
        return found or {name: {"ready": True, "incarnation": "", "reason": ""} for name in services}

    async def readiness(self, *services: str) -> dict[str, Readiness]:
        """The current readiness of each service, without waiting."""
        try:
            return await self.wait(*services, timeout=0.0)
        except NotReady as error:
            return error.services or {name: readiness_of(await self.service(name)) for name in services}

    async def requests(self) -> list[RequestView]:
        return await self.do(calls.requests())

    async def release(self, id: str, requester: str | None = None) -> None:
        await self.do(calls.release(id, requester))

    @property
    def watcher(self) -> AsyncWatcher:
        """Tells requests of this client when they lose something."""
        self._at_home()
        if self._watcher is None:
            self._watcher = AsyncWatcher(self)
        return self._watcher

    # -- services ----------------------------------------------------------------------------------------------

    async def services(self) -> list[ServiceView]:
        return await self.do(calls.services())

    async def groups(self) -> list[GroupView]:
        return await self.do(calls.groups())

    async def service(self, name: str) -> ServiceView:
        return await self.do(calls.service(name))

    async def why(self, name: str) -> list[Why]:
        return await self.do(calls.why(name))

    async def usage(self) -> Usage:
        return await self.do(calls.usage())

    async def status(self) -> dict[str, Any]:
        return await self.do(calls.status())

    async def plan(self) -> dict[str, Any]:
        return await self.do(calls.plan())

    async def restart(self, name: str, force: bool = False, wait: float | None = None) -> list[str]:
        """Stops and starts a service, or each of a group; returns their names. Drivers only with `force`. `wait`:
        seconds to wait until the wanted ones are ready again in a new run."""
        if wait is None:
            return await self.do(calls.restart(name, force))
        end = time.monotonic() + wait
        before = {s["service"]: s for s in await self.services()}
        names = await self.do(calls.restart(name, force))
        runs = {n: before[n]["incarnation"] for n in names if n in before and before[n]["wanted"]}
        while runs:
            await self.wait(*runs, timeout=max(0.0, end - time.monotonic()))
            old = [n for n, run in runs.items() if (await self.service(n))["incarnation"] == run]
            if not old:
                break
            if time.monotonic() > end:
                raise not_restarted(old[0], wait)
            await asyncio.sleep(RESTART_PAUSE)
        return names

    async def hold(self, name: str, seconds: float, reason: str = "", force: bool = False) -> list[str]:
        """Keeps a service, or those of a group, from being active, regardless of requests; returns their names. Without
        `force`, raises Refused if that stops a driver or other services, which are in `confirm`."""
        return await self.do(calls.hold(name, seconds, reason, force))

    async def unhold(self, name: str) -> None:
        await self.do(calls.unhold(name))

    async def suspend(self, seconds: float, reason: str = "") -> None:
        await self.do(calls.suspend(seconds, reason))

    async def unsuspend(self) -> None:
        await self.do(calls.unsuspend())

    # -- manifests ---------------------------------------------------------------------------------------------

    async def manifests(self) -> list[ManifestView]:
        return await self.do(calls.manifests())

    async def manifest(self, kind: str, name: str) -> str:
        """The text of a manifest."""
        return await self.do(calls.manifest(kind, name))

    async def put_manifest(self, kind: str, name: str, text: str, base: str | None, message: str = "") -> ManifestView:
        """Writes a manifest; `base` is the digest of the version that was edited, None for a new one."""
        return await self.do(calls.put_manifest(kind, name, text, base, message))

    async def delete_manifest(self, kind: str, name: str, base: str, message: str = "") -> None:
        await self.do(calls.delete_manifest(kind, name, base, message))

    async def put_service(self, name: str, spec: Spec, message: str = "") -> ManifestView:
        """Creates a service with this `spec`, or changes it to that."""
        base = calls.digest_of(await self.manifests(), "Service", name)
        return await self.put_manifest("Service", name, calls.manifest_text("Service", name, spec), base, message)

    async def remove_service(self, name: str, message: str = "") -> None:
        """Removes a service; removing twice is fine."""
        base = calls.digest_of(await self.manifests(), "Service", name)
        if base is not None:
            await self.delete_manifest("Service", name, base, message)

    # -- events ------------------------------------------------------------------------------------------------

    async def events(
        self,
        cursor: int | None = None,
        follow: bool = False,
        tail: int = 0,
        mine: bool = False,
        requester: str | None = None,
        only: Mapping[str, Any] | None = None,
    ) -> AsyncIterator[Event]:
        """Like Client.events."""
        while True:
            connection: AsyncConnection | None = None
            try:
                connection = await AsyncConnection.open(self.address, self.timeout)
                async for event in events_of(connection, calls.events(cursor, follow, tail, mine, requester, only)):
                    cursor = event["seq"]
                    if "kind" in event:
                        yield event
                if not follow:
                    return
            except (OSError, Unreachable) as error:
                if not follow:
                    raise error if isinstance(error, Error) else unreachable(str(self.address), error) from error
            finally:
                if connection:
                    connection.close()
            await asyncio.sleep(0.2)

    # -- plumbing ----------------------------------------------------------------------------------------------

    async def call(self, method: str, path: str, body: Any = None) -> Any:
        """Makes any call of the API; returns JSON or text. Raises a subclass of Error."""
        return await self.do(Call(method, path, body))

    async def do(self, call: Call[T], patience: float | None = None, timeout: float | None = None) -> T:
        """Makes a call, and repeats it while rorg does not answer."""
        attempts = Attempts(call, self.patience if patience is None else patience, str(self.address))
        deadline = time.monotonic() + (call.wait or 0.0)
        while True:
            try:
                answer = await self._once(call, deadline - time.monotonic(), timeout or self.timeout)
            except Failed as failed:
                await asyncio.sleep(attempts.again(failed, time.monotonic()))
                continue
            self._newest.note(call, answer)
            return call.told(answer)  # type: ignore[no-any-return]

    async def _once(self, call: Call[Any], left: float, timeout: float) -> Answer:
        idle = self._at_home()
        connection = idle.pop() if idle and not call.once else None
        stale = connection is not None
        timeout += max(0.0, left) + (calls.HELD if call.not_before(self._newest) else 0.0)
        try:
            connection = connection or await AsyncConnection.open(self.address, timeout)
        except OSError as error:
            raise Failed(error, sent=False) from error
        whole = False
        try:
            data = asking(call.method, call.at(left), call.body, call.headers(self._newest))
            answer = await connection.ask(data, reading(), timeout)
            whole = True
        except (OSError, ValueError) as error:
            raise Failed(error, sent=True, stale=stale) from error
        finally:
            if whole and not answer.last:
                self._at_home().append(connection)
            else:
                connection.close()
        if failed := calls.not_now(answer):
            raise failed
        return answer
