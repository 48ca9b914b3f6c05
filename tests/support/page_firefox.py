"""A page of `rorg ui` in Firefox, driven by WebDriver BiDi (w3.org/TR/webdriver-bidi), which Firefox speaks itself."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from tools import tool
from websocket import WebSocket, WebSocketTimeoutException, create_connection

QUIET = {
    "app.update.enabled": False,
    "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "services.settings.server": "data:,",
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
}


class Firefox:
    """One page. `complaints`: what its console has told."""

    def __init__(self, folder: Path) -> None:
        firefox = shutil.which("firefox") or tool("firefox-esr")
        lines = (f"user_pref({json.dumps(key)}, {json.dumps(value)});" for key, value in QUIET.items())
        (folder / "user.js").write_text("\n".join(lines))
        command = [firefox, "--headless", "--no-remote", "--profile", str(folder), "--remote-debugging-port", "0"]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        for line in self.process.stderr:
            if found := re.search(r"listening on (ws://\S+)", line):
                break
        else:
            pytest.fail("Firefox has ended")
        self.complaints: list[str] = []
        self._number = 0
        self.socket: WebSocket = create_connection(f"{found[1]}/session", timeout=30, suppress_origin=True)
        self.call("session.new", capabilities={})
        self.call("session.subscribe", events=["log.entryAdded"])
        self.context = self.call("browsingContext.getTree")["contexts"][0]["context"]

    def call(self, method: str, **params: Any) -> Any:
        self._number += 1
        self.socket.send(json.dumps({"id": self._number, "method": method, "params": params}))
        while True:
            told = json.loads(self.socket.recv())
            if told.get("method") == "log.entryAdded" and told["params"]["level"] in ("error", "warn"):
                self.complaints.append(str(told["params"]["text"]))
            if told.get("id") == self._number:
                assert told["type"] == "success", told
                return told["result"]

    def go(self, address: str) -> None:
        self.call("browsingContext.navigate", context=self.context, url=address, wait="complete")

    def run(self, expression: str) -> Any:
        """The value of an expression in the page, if it is a plain one."""
        where = {"context": self.context}
        told = self.call("script.evaluate", expression=expression, target=where, awaitPromise=True)
        assert told["type"] == "success", told
        return told["result"].get("value")

    def wait(self, selector: str, seconds: float = 20.0) -> None:
        """Wait until something on the page is as a selector says."""
        end = time.monotonic() + seconds
        while not self.run(f"Boolean(document.querySelector({json.dumps(selector)}))"):
            assert time.monotonic() < end, f"no {selector}: {self.run('document.body.innerText')[:500]}"
            time.sleep(0.1)

    def close(self) -> None:
        with contextlib.suppress(OSError, WebSocketTimeoutException):
            self.socket.close()
        self.process.terminate()
        self.process.communicate(timeout=30)
