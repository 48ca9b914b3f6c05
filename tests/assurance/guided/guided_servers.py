"""The same of what comes by sockets: bodies of API calls to a running rorg, and answers of an engine."""

from __future__ import annotations

import json
import socketserver
import threading
from contextlib import closing, suppress
from pathlib import Path

from api_nonsense import BODIES, FIELDS, NO_HTTP, ROUTES, SERVICES, answered, connected
from guided.guided_targets import TARGETS, Target
from robots import RealRobot

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.engines.docker.engine import DockerEngine
from rorg.engines.log_lines import Reading
from rorg.errors import RorgError

CALLS = [(method, path) for method, path, route in ROUTES if "requestBody" in route]
PLACES = {"requester": "developer", "id": "tour", "service": "lidar", "name": "lidar", "kind": "Service"}
GOOD = (200, 204, 307, *range(400, 432), 503, 504)


class Bodies(Target):
    """Bodies of API calls. The first line of an input is the number of a call."""

    json = True
    words = ("services", "reason", "priority", "ttl", "duration", "force", "text", "base", "message", "10s")

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.robot = RealRobot(folder, "process", None, with_server=True)
        self.robot.declare(SERVICES, groups={"eyes": {"services": ["camera", "lidar"]}})
        self.robot.wait(lambda: "camera" in self.robot.active())

    def seeds(self) -> list[bytes]:
        return [f"{n}\n{json.dumps(body)}".encode() for n in range(len(CALLS)) for body in BODIES]

    def attempt(self, data: bytes) -> None:
        head, _, body = data.partition(b"\n")
        method, path = CALLS[int(head) % len(CALLS) if head.isdigit() and len(head) < 9 else 0]
        for place, value in PLACES.items():
            path = path.replace(f"{{{place}}}", value)
        lines = (f"{method} {path} HTTP/1.1", "host: x", "connection: close", f"content-length: {len(body)}")
        with closing(connected(self.robot)) as connection:
            connection.sendall("\r\n".join(lines).encode() + b"\r\n\r\n" + body)
            status, answer = answered(connection)
        assert status in GOOD, (path, status, answer[:500])
        assert status < 400 or answer == NO_HTTP or set(json.loads(answer)) >= FIELDS, (path, status, answer[:500])

    def close(self) -> None:
        self.robot.close()


ID = "0123456789abcdef" * 4
LABELS = {LABEL_OWNER: "mine", LABEL_SERVICE: "cam", "rorg.io/spec": "v1:0"}
ROW = {"Id": ID, "Names": ["/cam"], "State": "running", "Labels": LABELS}
INSPECTION = {
    "Id": ID,
    "Name": "/cam",
    "Created": "2026-01-01T00:00:00Z",
    "Image": "sha256:0",
    "State": {"Status": "running", "StartedAt": "2026-01-01T00:00:00Z", "Pid": 7, "ExitCode": 0, "Health": None},
    "Config": {"Labels": LABELS, "StopSignal": "SIGINT"},
    "HostConfig": {"NanoCpus": 1000000000, "PidsLimit": 9, "Memory": 1, "RestartPolicy": {"Name": "no"}},
    "NetworkSettings": {"Networks": {"lan": {"NetworkID": "1"}}},
}
ANSWERS = {
    "list": [ROW],
    "inspect": INSPECTION,
    "events": {"Action": "start", "Type": "container", "Actor": {"ID": ID, "Attributes": LABELS}},
    "networks": [{"Name": "lan", "Id": "1", "Labels": LABELS}],
    "volumes": {"Volumes": [{"Name": "maps", "Labels": LABELS}]},
    "df": {"Images": [{"Id": "sha256:0", "RepoTags": ["a:1"], "Labels": None, "Size": 1, "Created": 1}]},
    "images": [{"Id": "sha256:0", "RepoTags": ["a:1"]}],
    "image": {"Id": "sha256:0", "RepoTags": ["a:1"], "Config": {}},
    "made": {"Id": ID, "Warnings": []},
    "error": {"message": "no such container"},
}
"""An answer of each kind; the first line of an input names the kind."""
OK = b"HTTP/1.1 %d OK\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n%s"
PING = b"HTTP/1.1 200 OK\r\nApi-Version: 1.43\r\nContent-Length: 2\r\n\r\nOK"


class Server(socketserver.ThreadingUnixStreamServer):
    """An engine that gives `answers`; they end a connection if they are to be of a stream."""

    daemon_threads = True
    answers: dict[str, bytes]


class Handler(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        with suppress(OSError):
            while (line := self.rfile.readline()) and line.strip():
                length = 0
                while header := self.rfile.readline().strip():
                    if header.lower().startswith(b"content-length:"):
                        length = int(header.partition(b":")[2])
                self.rfile.read(length)
                self.wfile.write(PING if b"/_ping" in line else self.answer(line.decode()))

    def answer(self, line: str) -> bytes:
        assert isinstance(self.server, Server)
        kind = kind_of(line)
        content = self.server.answers[kind]
        return OK % (404 if kind == "error" else 200, len(content), content)


def kind_of(line: str) -> str:
    """The kind of answer to a request."""
    path = line.split()[1].partition("?")[0]
    for part, kind in (("/containers/json", "list"), ("/containers/create", "made"), ("/start", "error")):
        if path.endswith(part):
            return kind
    if path.endswith("/json"):
        return "images" if path.endswith("/images/json") else "image" if "/images/" in path else "inspect"
    return next((k for k in ("events", "networks", "volumes", "df") if path.endswith(k)), "error")


class Answers(Target):
    """Answers of Docker's API."""

    json = True
    words = tuple(sorted({*ROW, *INSPECTION, "null", "true", "1e400", '{"', '": ', "[]", "NetworkID", "Attributes"}))

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.server = Server(str(folder / "engine.sock"), Handler)
        threading.Thread(target=self.server.serve_forever, args=(0.05,), daemon=True).start()
        self.engine = DockerEngine("mine", f"unix://{folder}/engine.sock")

    def seeds(self) -> list[bytes]:
        return [f"{kind}\n{json.dumps(answer)}".encode() for kind, answer in ANSWERS.items()]

    def attempt(self, data: bytes) -> None:
        head, _, content = data.partition(b"\n")
        kind = head.decode(errors="replace")
        if kind not in ANSWERS:
            return
        self.server.answers = {k: json.dumps(answer).encode() for k, answer in ANSWERS.items()} | {kind: content}
        for call in CALLED[kind]:
            with suppress(RorgError):
                getattr(self, call)()

    def list(self) -> None:
        known = {c.id: c for c in self.engine.list()}
        self.engine.list(known)

    def inspect(self) -> None:
        self.engine.inspect("abc")

    def follow(self) -> None:
        events = self.engine.events(Reading())
        next(events)
        next(events, None)

    def objects(self) -> None:
        self.engine.find_objects(["network/lan", "volume/maps"])

    def disk(self) -> None:
        self.engine.images()

    def images(self) -> None:
        self.engine.missing_images(["a:1"])

    def create(self) -> None:
        self.engine.create("cam", {"image": "a:1", "command": ["x"]}, LABELS)

    def start(self) -> None:
        self.engine.start("abc")

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()


CALLED = {
    "list": ("list",),
    "inspect": ("inspect", "list"),
    "events": ("follow", "list"),
    "networks": ("objects",),
    "volumes": ("objects",),
    "df": ("disk",),
    "images": ("images",),
    "image": ("create", "images"),
    "made": ("create",),
    "error": ("start",),
}
"""What is called if an answer of a kind is another one."""

TARGETS |= {"bodies": Bodies, "answers": Answers}
