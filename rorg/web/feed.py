"""What the pages show, asked once for all of them: the state of the robot, as changes, and its events.

rorg is asked when something happens, but at most so often, whatever the number of pages and events.
"""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from rorg_client import Client

LEAST, MOST = 1.0, 2.0
"""Seconds between two looks at the state: at least, and at most."""
USAGE_EVERY = 2.0
"""Seconds between two looks at CPU and memory."""
BEHIND = 64
"""Messages that a page may be late; then it begins again with the whole state."""
PAST = 200
"""Events that a new page gets."""
KEPT = 900
"""Samples of CPU and memory that a new page gets: half an hour."""
Message = dict[str, Any]


class Feed:
    """Asks rorg in threads of its own while there is a page, and tells all pages. `client` makes a client."""

    def __init__(self, client: Callable[[], Client]) -> None:
        self._client = client
        self._pages: set[asyncio.Queue[str]] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._wake, self._ended, self._wanted = threading.Event(), threading.Event(), threading.Event()
        self._lock = threading.Lock()
        self._state: Message = {}
        self._events: list[Message] = []
        self._news: list[Message] = []
        """Events that the pages will get with the next change."""
        self._samples: list[Message] = []

    def start(self) -> None:
        """Begin; must be called in the loop of the server."""
        self._loop = asyncio.get_running_loop()
        for target in (self._look, self._listen):
            threading.Thread(target=target, name=f"feed-{target.__name__}", daemon=True).start()

    def stop(self) -> None:
        for event in (self._ended, self._wanted, self._wake):
            event.set()

    def join(self) -> asyncio.Queue[str]:
        """Take in a page. Its first message is the whole state."""
        queue: asyncio.Queue[str] = asyncio.Queue(BEHIND)
        with self._lock:
            queue.put_nowait(
                json.dumps({**self._state, "whole": True, "events": self._events, "samples": self._samples})
            )
            self._pages.add(queue)
        self._wanted.set()
        self._wake.set()
        return queue

    def leave(self, queue: asyncio.Queue[str]) -> None:
        with self._lock:
            self._pages.discard(queue)
            if not self._pages:
                self._wanted.clear()

    # -- asking ------------------------------------------------------------------------------------------------

    def _look(self) -> None:
        client, used = self._client(), 0.0
        while not self._ended.is_set():
            self._wanted.wait()
            self._wake.wait(MOST)
            self._wake.clear()
            began = time.monotonic()
            try:
                change = self._changed(client)
                if began >= used + USAGE_EVERY:
                    used, change = began, {**change, "samples": [self._sample(client)]}
            except Exception as error:  # without this thread, pages would show an old state as if it were the present
                change = self._merged({"lost": str(error) or type(error).__name__})
            self._tell({**change, **self._happened()})
            self._ended.wait(max(0.0, LEAST - (time.monotonic() - began)))

    def _changed(self, client: Client) -> Message:
        """Return what has changed since the last look."""
        status = client.call("GET", "/v1/status")
        services = status.pop("services")
        for unused in ("runs", "instance"):
            status.pop(unused, None)
        known = self._state.get("status", {})
        relations = [
            (s.get("tree", {}).get("fingerprint"), [r["id"] for r in s.get("requests", ())]) for s in (known, status)
        ]
        change: Message = {"lost": "", "status": status, "services": services}
        if "graph" not in self._state or relations[0] != relations[1]:
            change["graph"] = client.call("GET", "/v1/graph")
        change["machines"] = client.call("GET", "/v1/machines") if self._several(services) else []
        return self._merged(change)

    def _several(self, services: Mapping[str, Any]) -> bool:
        return any(service["machine"] for service in services.values())

    def _merged(self, change: Message) -> Message:
        """Note a change, and return the part of it that is new. Services that are gone are null."""
        with self._lock:
            before = self._state
            new = {key: value for key, value in change.items() if before.get(key) != value}
            self._state = {**before, **change}
        if "services" in new:
            old, now = before.get("services", {}), new["services"]
            new["services"] = {name: now.get(name) for name in {**old, **now} if old.get(name) != now.get(name)}
        return new

    def _sample(self, client: Client) -> Message:
        """Return what is used now. Of older samples only the machine's part is kept: the plots show no more."""
        usage = dict(client.call("GET", "/v1/usage"))
        with self._lock:
            older = [{"at": one["at"], "machine": one["machine"], "services": {}} for one in self._samples[-1:]]
            self._samples = [*self._samples[-KEPT + 1 : -1], *older, usage]
        return usage

    def _listen(self) -> None:
        """Follow the events. Each one is a reason to look at the state."""
        client = self._client()
        while not self._ended.is_set():
            self._wanted.wait()
            try:
                last = self._last_event()
                for event in client.events(last, follow=True, tail=PAST if last is None else 0):
                    if "kind" in event:
                        with self._lock:
                            self._news.append(dict(event))
                        self._wake.set()
            except Exception:  # the other thread says what is wrong
                self._wake.set()
            self._ended.wait(1.0)

    def _last_event(self) -> int | None:
        with self._lock:
            known = [*self._events, *self._news]
        return int(known[-1]["seq"]) if known else None

    def _happened(self) -> Message:
        """Return the events since the last call, for all pages."""
        with self._lock:
            news, self._news = self._news, []
            self._events = [*self._events, *news][-PAST:]
        return {"events": news} if news else {}

    # -- telling -----------------------------------------------------------------------------------------------

    def _tell(self, change: Message) -> None:
        if change and self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._hand_out, json.dumps(change))

    def _hand_out(self, text: str) -> None:
        with self._lock:
            pages = tuple(self._pages)
        for queue in pages:
            try:
                queue.put_nowait(text)
            except asyncio.QueueFull:  # a page that does not read; it begins again
                self.leave(queue)
                while not queue.empty():
                    queue.get_nowait()
                queue.put_nowait("")
