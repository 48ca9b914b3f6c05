"""Requests to the API that make no sense, and what answers them."""

from __future__ import annotations

import json
import socket

from common import ROOT

PATHS = json.loads((ROOT / "schemas/openapi.json").read_text())["paths"]

ROUTES = [(method.upper(), path, route) for path, methods in PATHS.items() for method, route in methods.items()]

SERVICES = {
    "camera": {"always_on": True, "may_request": ["lidar"], "may_restart": ["lidar"], "may_manage": ["nav-*"]},
    "lidar": {},
}

MANIFEST = """\
apiVersion: rorg/v1
kind: Service
metadata: {name: nav-one, description: one}
spec: {image: base, command: [sleep, "1000"], needs: [lidar], idle: {action: stop, linger: 1s}, ready: {log: "^up$"}}
"""

BODIES = [
    {"services": ["lidar"], "reason": "a visitor", "priority": 50, "ttl": "10s"},
    {"services": ["eyes"], "duration": "10m", "reason": "x"},
    {"duration": "1s", "reason": "maintenance"},
    {"services": ["old"]},
    {"text": MANIFEST, "base": None, "message": "one more"},
]

FIELDS = {"type", "title", "status", "code", "cause", "remedy"}

NO_HTTP = b"Invalid HTTP request received."

ANSWER = 10.0
"""Seconds to wait for an answer at the most."""


def connected(robot, service: str = "") -> socket.socket:
    found = socket.socket(socket.AF_UNIX)
    found.settimeout(ANSWER)
    found.connect(robot.socket(service))
    return found


def answered(connection: socket.socket) -> tuple[int, bytes]:
    """Status and body of the one answer of a connection; 0 where there is none."""
    text = b""
    while more := connection.recv(1 << 20):
        text += more
    head, _, body = text.partition(b"\r\n\r\n")
    return int(head.split(b" ")[1]) if head.startswith(b"HTTP/1.1 ") else 0, body
