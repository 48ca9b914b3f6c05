"""Draws docs/ui-*.png: the page of `rorg ui` for the robot of `rorg demo --keep`, in Debian's Chromium.

Run it while that robot runs: python docs/page_pictures.py SOCKET
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests/support"))
from page_browser import Ui, Watched, browser  # noqa: E402
from rorg_client import Client  # noqa: E402


def main(rorg: str) -> None:
    """Draw each view once, with a request that is released and made again."""
    client = Client(rorg)
    client.release("action", "behavioral")  # the tour on which the demo leaves it
    ui = Ui(rorg)
    with browser() as chromium:
        context = chromium.new_context(viewport={"width": 1400, "height": 900}, color_scheme="light")
        watched = Watched(context, ui.address)
        for number in range(3):
            reason = f"visitor {number + 1}"
            client.call("PUT", "/v1/requests/visitor", {"services": ["navigation_route"], "reason": reason})
            time.sleep(8)
            if number < 2:
                client.release("visitor")
                time.sleep(6)
        watched.view("now/navigation_route")
        time.sleep(3)
        watched.page.screenshot(path=HERE / "ui-now.png")
        watched.view("time")
        time.sleep(6)
        watched.page.screenshot(path=HERE / "ui-time.png")
        client.release("visitor")
        print(watched.complaints)
    ui.close()


if __name__ == "__main__":
    main(sys.argv[1])
