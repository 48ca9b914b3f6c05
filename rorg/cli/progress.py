"""Shows on a terminal what is being waited for: a few lines on standard error, rewritten in place and erased at the
end."""

from __future__ import annotations

import os
import sys
import threading
import time
from typing import Any

from rorg_client import Client, Error

from rorg.cli.published import late
from rorg.cli.terminal import printable

QUIET = 0.4
"""Seconds before anything is shown: most waits are shorter."""
PAUSE = 1.0
"""Seconds between two looks: each takes time that rorg needs for what is waited for."""
ANSWER = 2.0
MOST = 8
"""Causes that are shown."""


class Progress:
    """A context manager that looks from its own thread."""

    def __init__(self, client: Client, names: list[str]) -> None:
        self.client, self.names = client.like(ANSWER, 0.0), names
        self.begun = time.monotonic()
        self._over, self._guard, self._drawn = threading.Event(), threading.Lock(), 0

    def __enter__(self) -> None:
        threading.Thread(target=self._run, name="rorg-progress", daemon=True).start()

    def __exit__(self, *_: object) -> None:
        with self._guard:  # so that nothing is drawn after this
            self._over.set()
            self._erase()

    def _run(self) -> None:
        asked: list[str] = []
        pause = QUIET
        while not self._over.wait(pause):
            pause = PAUSE
            try:
                asked = asked or list(self.client.readiness(*self.names))
                view = self.client.status()
            except Error:
                continue  # the waiting call reports it
            self._draw(waiting(view, asked, time.monotonic() - self.begun))
        self.client.close()

    def _draw(self, lines: list[str]) -> None:
        try:
            width = os.get_terminal_size(sys.stderr.fileno()).columns or 80
        except (OSError, ValueError):
            width = 80
        with self._guard:
            if self._over.is_set():
                return
            self._erase()
            sys.stderr.write("".join(f"{printable(line)[: width - 1]}\n" for line in lines))
            sys.stderr.flush()
            self._drawn = len(lines)

    def _erase(self) -> None:
        """Erases what was drawn last."""
        if self._drawn:
            sys.stderr.write(f"\033[{self._drawn}A\r\033[J")
            sys.stderr.flush()
            self._drawn = 0


def waiting(view: dict[str, Any], names: list[str], seconds: float) -> list[str]:
    """The services that are not ready, of these names, and what they wait for."""
    late_causes = late(view, names)
    count = sum(len(cause.names) for cause in late_causes)
    told = [view["suspended"]] if count and view.get("suspended") else list(map(str, late_causes))
    more = [f"  and {len(told) - MOST} more"] if len(told) > MOST else []
    head = f"{len(names) - count} of {len(names)} ready, {seconds:.0f} s"
    return [head, *(f"  {text}" for text in told[:MOST]), *more]
