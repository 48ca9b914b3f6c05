"""A page of `rorg ui` in Debian's Chromium."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import axe_playwright_python
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright
from tools import tool

FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking")
MORE = ("--disable-component-update", "--disable-sync")
AXE = Path(axe_playwright_python.__file__).parent / "axe.min.js"


@contextmanager
def browser(*more: str) -> Iterator[Browser]:
    chromium = tool("chromium")
    with sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=chromium, args=[*FLAGS, *MORE, *more])
        try:
            yield made
        finally:
            made.close()


class Ui:
    """One `rorg ui`, for the rorg on a socket."""

    def __init__(self, rorg: str, *words: str) -> None:
        command = [sys.executable, "-m", "rorg", "ui", "--no-browser", "--port", "0", *words]
        self.process = subprocess.Popen(
            command, env={**os.environ, "RORG_SOCKET": rorg}, stderr=subprocess.PIPE, text=True
        )
        assert self.process.stderr is not None
        said = self.process.stderr.readline()
        found = re.search(r"http://\S+", said)
        assert found, said + self.process.stderr.read()
        self.address = found[0]
        self.origin, _, self.token = self.address.partition("/?token=")

    def close(self) -> None:
        self.process.terminate()
        self.process.communicate(timeout=10)


class Watched:
    """A page, and everything that it complains of."""

    def __init__(self, context: BrowserContext, address: str) -> None:
        self.page: Page = context.new_page()
        self.complaints: list[str] = []
        self.page.on("console", lambda m: self.complaints.append(m.text) if m.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(address)
        self.page.wait_for_selector(".counts li")

    def view(self, name: str) -> None:
        """Show another view, or a service in it: now/navigation."""
        self.page.evaluate("hash => { location.hash = hash }", name)

    def mistakes(self) -> list[str]:
        """What axe finds on the page as it is."""
        self.page.evaluate(AXE.read_text() + ";undefined")
        found = self.page.evaluate("axe.run(document, {resultTypes: ['violations']})")
        return [
            f"{one['id']}: {one['help']}: {node['html'][:150]} {node['failureSummary'][:200]}"
            for one in found["violations"]
            for node in one["nodes"][:3]
        ]
