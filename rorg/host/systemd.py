"""Tells systemd about a service of type notify (sd_notify): that it is ready, alive, stopping."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Callable


def notify(state: str) -> None:
    """Send `READY=1` and the like to NOTIFY_SOCKET; does nothing outside of systemd."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if address:
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.sendto(state.encode(), "\0" + address[1:] if address[0] == "@" else address)


class Watchdog:
    """Tells systemd twice in each WATCHDOG_USEC that the loop works: it wakes the loop, and checks that a pass
    follows."""

    def __init__(self, wake: Callable[[], None], passes: Callable[[], int]) -> None:
        self.wake, self.passes = wake, passes
        self.period = int(os.environ.get("WATCHDOG_USEC") or 0) / 1e6 / 2
        self._stop = threading.Event()

    def start(self) -> None:
        if self.period:
            threading.Thread(target=self._run, name="watchdog", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()

    def _run(self) -> None:
        seen = self.passes()
        while not self._stop.wait(self.period):
            if self.passes() > seen:
                notify("WATCHDOG=1")
            seen = self.passes()
            self.wake()
