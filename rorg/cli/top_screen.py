"""`rorg top` on a terminal: looks, keys, and their actions."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import replace
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text
from rorg_client import Error as ClientError
from rorg_client.types import RequestView, Usage

from rorg.cli.context import Context
from rorg.cli.keyboard import Keyboard
from rorg.cli.operations import operating
from rorg.cli.top_view import Deed, View, ask, frame, look, pressed
from rorg.errors import RorgError, Unconfirmed

FIRST = 0.3
"""Seconds between the first two looks: rates need two."""


class Screen:
    """The terminal while `rorg top` runs."""

    def __init__(self, context: Context, interval: float) -> None:
        self.context, self.interval = context, interval
        self.client = context.serving("look at what runs")
        self.view = View()
        self._before: Usage = self.client.usage()
        self._console = Console()
        self.found: dict[str, Any] | None = None
        self._live = Live(console=self._console, auto_refresh=False, screen=True, redirect_stderr=False)
        self._keyboard = Keyboard(self._enter, self._live.stop)

    def run(self) -> None:
        """Runs until a person quits."""
        with self._keyboard.taken():
            due = time.monotonic() + FIRST
            while True:
                self._draw()
                key = self._key(due - time.monotonic())
                if key:
                    self.view, deed = pressed(self.view, key, self._names())
                    if deed and deed.verb == "quit":
                        return
                    if deed:
                        self._do(deed)
                elif time.monotonic() >= due:
                    self._look()
                    due = time.monotonic() + self.interval

    def _key(self, seconds: float) -> str:
        try:
            return self._keyboard.key(seconds)
        except (EOFError, OSError):
            sys.exit(0)  # the terminal is gone

    def _names(self) -> list[str]:
        return [row["service"] for row in self.view.rows(self.found["services"])] if self.found else []

    def _enter(self) -> None:
        self._live.start()
        self._draw()

    def _draw(self) -> None:
        width, height = self._console.size
        lines = [
            Text.assemble(*line, no_wrap=True, overflow="ellipsis")
            for line in frame(self.view, self.found, width, height)
        ]
        self._live.update(Text("\n", no_wrap=True, overflow="ellipsis").join(lines), refresh=True)

    def _look(self) -> None:
        try:
            now = self.client.usage()
            self.found = look(self._before, now, self.client.status())
            self._before = now
        except ClientError as error:
            self.view = replace(self.view, message=str(error))

    def _do(self, deed: Deed) -> None:
        """Does what a key asks for. Failures become messages."""
        try:
            message = self._done(deed)
            self.view = replace(self.view, message=message)
        except Unconfirmed as unsure:
            self.view = ask(self.view, f"{unsure.why}. Restart?", deed._replace(force=True))
        except (ClientError, RorgError) as error:
            self.view = replace(self.view, message=str(error))

    def _done(self, deed: Deed) -> str:
        """Does it or asks first; a message about the result. Raises Unconfirmed."""
        robot, name = operating(self.context), deed.service
        if deed.verb == "logs":
            return self._logs(name)
        if deed.verb == "request":
            body = {"services": [name], "reason": "", "priority": None, "ttl": None}
            robot.put_request(name, "developer", body)
            return f"request '{name}' of developer: {name}"
        if deed.verb == "restart":
            return f"restart of {', '.join(robot.restart(name, deed.force))} requested"
        names = {name, *(g["name"] for g in self.client.groups() if name in g["services"])}
        requests = [r for r in self.client.requests() if names & set(r["services"]) and not r["standing"]]
        if not requests:
            return f"no request that can be released names {name}"
        told = ", ".join(map(_told, requests))
        if not deed.force:
            self.view = ask(self.view, f"Release {told}?", deed._replace(force=True))
            return ""
        for request in requests:
            robot.release(request["id"], request["requester"])
        return f"released: {told}"

    def _logs(self, name: str) -> str:
        """Runs `rorg logs` on the terminal; a message if that fails."""
        words = [sys.executable, "-m", "rorg", "logs", name, "--follow", "--tail", str(self._console.height)]
        env = {**os.environ, "RORG_STATE_DIR": str(self.context.state.path)}
        with self._keyboard.aside():
            done = subprocess.run(words, env=env, stderr=subprocess.PIPE, text=True)
        said = done.stderr.strip().splitlines()
        return said[-1] if done.returncode > 0 and said else ""


def _told(request: RequestView) -> str:
    return f"'{request['id']}' of {request['requester']} ({', '.join(request['services'])})"
