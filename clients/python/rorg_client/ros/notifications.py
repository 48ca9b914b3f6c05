"""Receives rorg's notifications from this machine, for the node to publish on a topic: a Policy posts them to the
bridge as to any other webhook."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

MOST = 64 << 10
"""Bytes of a notification."""


def serve(port: int, publish: Callable[[str], object]) -> ThreadingHTTPServer:
    """Answers at this port of the machine, in a thread; `publish` gets each notification as JSON."""

    class Handler(BaseHTTPRequestHandler):
        timeout = 10.0

        def do_POST(self) -> None:
            length = self.headers.get("Content-Length", "")
            text = self.rfile.read(int(length)) if length.isdigit() and int(length) <= MOST else b""
            try:
                found = json.loads(text)
            except ValueError:
                found = None
            fine = isinstance(found, dict)
            if fine:
                publish(json.dumps(found))
            self.send_response(204 if fine else 400)
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, name="notifications", daemon=True).start()
    return server
