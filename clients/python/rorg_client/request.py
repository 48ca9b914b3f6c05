"""A request held by a program, kept alive by a thread."""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
from typing import TYPE_CHECKING, Any, Callable, Sequence

from rorg_client import calls
from rorg_client.errors import Error, NotFound, NotReady
from rorg_client.loss import Loss

if TYPE_CHECKING:
    from concurrent.futures import Future

    from rorg_client.client import Client
    from rorg_client.types import Readiness

_numbers = itertools.count(1)


def new_id(service: str) -> str:
    """A new id, different in all processes and threads."""
    return f"{service[:40]}-{os.getpid()}-{next(_numbers)}"


class Kept:
    """The state of a request in both clients. It belongs to the process that made it: a forked child that leaves its
    parent's block, or releases it, changes nothing."""

    def __init__(
        self,
        services: Sequence[str],
        id: str,
        ttl: float | None,
        reason: str,
        priority: int | None,
        requester: str | None,
    ) -> None:
        self.services, self.id, self.ttl, self.requester = tuple(services), id, ttl, requester
        self.body: dict[str, Any] = {
            "services": list(services),
            "reason": reason,
            "priority": priority,
            "ttl": None if ttl is None else calls.duration(ttl),
        }
        self.losses: list[Loss] = []
        """Losses since it was last ready."""
        self.runs: dict[str, str] = {}
        """The last ready run of each service, if known."""
        self.arrived = False
        self._given_up, self._pid = False, os.getpid()

    @property
    def ours(self) -> bool:
        """Whether this process keeps and releases it."""
        return not self._given_up and self._pid == os.getpid()

    def ready_now(self, found: dict[str, Readiness], known: int) -> bool:
        """Forgets the losses `known` before the question, and returns whether another came since for a run that was
        reported ready: then it was lost between the answer and now."""
        self.runs = {name: told["incarnation"] for name, told in found.items() if told["incarnation"]}
        self.losses = [
            loss for loss in self.losses[known:] if loss.incarnation and self.runs.get(loss.service) == loss.incarnation
        ]
        return bool(self.losses)

    def takes(self, loss: Loss) -> bool:
        """Whether a loss is new; then it is recorded. Events and a look at the service may both report the same one."""
        known = any(
            one.cause == loss.cause if loss.cause == "dropped" else one[::3] == loss[::3] and one.incarnation
            for one in self.losses
        )
        if not known:
            self.losses.append(loss)
        return not known


def unknown(id: str) -> Loss:
    return Loss("", "dropped", f"rorg no longer knew the request '{id}'")


def released(id: str, services: Sequence[str]) -> NotReady:
    """The error of a wait whose request is released meanwhile."""
    cause = f"the request '{id}' was released"
    return NotReady(f"cannot wait for {', '.join(services)}", cause, "a new request", "not-ready")


def tell(call: Callable[[Loss], None], loss: Loss) -> None:
    """Calls a callback. An exception in it is reported, and does not affect others."""
    try:
        call(loss)
    except Exception:
        import traceback

        traceback.print_exc()


class Request(Kept):
    """A context manager; release() may be called twice. Its heartbeat continues through restarts of rorg."""

    def __init__(
        self,
        client: Client,
        services: Sequence[str],
        id: str,
        ttl: float | None,
        reason: str,
        priority: int | None,
        requester: str | None,
    ) -> None:
        super().__init__(services, id, ttl, reason, priority, requester)
        self.client = client
        self._over, self._lost, self._guard = threading.Event(), threading.Event(), threading.Lock()
        self._callbacks: list[Callable[[Loss], None]] = []
        self._beat: threading.Thread | None = None
        self._waiting: list[Client] = []
        """Pending futures."""

    def put(self, wait: float | None = None) -> None:
        """Sends it, and keeps it alive from now on. With `wait`, returns when all is ready, or raises NotReady."""
        if wait is not None:
            self._keep()  # it may have to be renewed before the answer
        known = len(self.losses)
        try:
            told = self.client.do(calls.put_request(self.id, self.body, self.requester, wait))
        except BaseException as error:
            self.arrived = isinstance(error, NotReady)
            if not self.arrived:
                self._stop()
            raise
        self.arrived = True
        self._keep()
        if wait is not None:
            if "readiness" in told:
                self._is_ready(told["readiness"], known)
            else:  # an earlier rorg, which does not wait
                self.wait(wait)

    def _keep(self) -> None:
        if self.ttl is not None and self._beat is None:
            self._beat = threading.Thread(target=self._heartbeat, name=f"rorg-{self.id}", daemon=True)
            self._beat.start()

    def _heartbeat(self) -> None:
        # A beat must not wait forever for an rorg that does not answer: the next one may reach a restarted rorg.
        pause = (self.ttl or calls.TTL) / 3
        client = self.client.like(min(pause, self.client.timeout), 0.0)
        while not self._over.wait(pause):
            try:
                client.do(calls.renew(self.id, self.requester))
            except NotFound:
                if self.arrived and not self._over.is_set():
                    with contextlib.suppress(Error):
                        client.do(calls.put_request(self.id, self.body, self.requester))
                    self.note(unknown(self.id))
            except Error:
                continue
        client.close()

    # -- readiness and loss ------------------------------------------------------------------------------------

    def wait(self, timeout: float = 30.0) -> Request:
        """Returns when its services and all that they need are ready; raises NotReady with what is missing."""
        return self._wait(self.client, timeout)

    def _wait(self, client: Client, timeout: float) -> Request:
        known = len(self.losses)
        self._is_ready(client.wait(*self.services, timeout=timeout), known)
        return self

    def _is_ready(self, found: dict[str, Readiness], known: int) -> None:
        with self._guard:
            if not self.ready_now(found, known):
                self._lost.clear()

    def ready(self, timeout: float = 30.0) -> Future[Request]:
        """The same as a future: it gives the request when all are ready; otherwise, or if it is released, NotReady."""
        from concurrent.futures import Future

        future: Future[Request] = Future()

        def run() -> None:
            if not future.set_running_or_notify_cancel():
                return
            client = self.client.like(self.client.timeout, self.client.patience)
            self._waiting.append(client)
            try:
                if self._over.is_set():  # release() later finds the client, and makes it hang up
                    raise released(self.id, self.services)
                future.set_result(self._wait(client, timeout))
            except BaseException as error:
                future.set_exception(released(self.id, self.services) if self._over.is_set() else error)
            finally:
                self._waiting.remove(client)
                client.close()

        threading.Thread(target=run, name=f"rorg-ready-{self.id}", daemon=True).start()
        return future

    def readiness(self) -> dict[str, Readiness]:
        """The current readiness of each of its services."""
        return self.client.readiness(*self.services)

    @property
    def lost(self) -> threading.Event:
        """Set when a service that was ready is no longer; `losses` say which one and why. wait() clears it."""
        self._watch()
        return self._lost

    def on_lost(self, call: Callable[[Loss], None]) -> None:
        """Registers a function that is called for every loss, in a thread of the client."""
        self._callbacks.append(call)
        self._watch()

    def _watch(self) -> None:
        if self.ours:
            self.client.watcher.add(self)

    def note(self, loss: Loss) -> None:
        """Records a loss."""
        with self._guard:
            news = self.takes(loss)
            if news:
                self._lost.set()
        for call in list(self._callbacks) if news else ():
            tell(call, loss)

    # -- the end -----------------------------------------------------------------------------------------------

    def release(self) -> None:
        """Releases it. Like every call, this is repeated while rorg does not answer; if it still fails, call it
        again."""
        if not self.ours:
            return
        self._stop()
        if self._beat is not None and self._beat is not threading.current_thread():
            self._beat.join()
        self.client.do(calls.release(self.id, self.requester))
        self._given_up = True

    def give_up(self) -> None:
        """Releases it after an error, without raising another: then the lease ends it."""
        with contextlib.suppress(Error):
            self.release()

    def abandon(self) -> None:
        """Stops keeping it without a release, because another request with the same id has replaced it."""
        self._given_up = True
        self._stop()

    def _stop(self) -> None:
        self._over.set()
        for client in list(self._waiting):
            client.hang_up()
        if self.client._watcher is not None:
            self.client._watcher.remove(self)

    def __enter__(self) -> Request:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self.release()
        else:
            self.give_up()
