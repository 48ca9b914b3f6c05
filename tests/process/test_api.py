"""The API, through real sockets: what it does, who may, and what it withstands."""

from __future__ import annotations

import json
import os
import random
import socket
import subprocess
import sys
import threading
import time

import pytest
from common import ROOT, wait_for
from robots import RealRobot

from rorg.api.permissions import OPERATIONS
from rorg.client import Client, Forbidden, Invalid, NotFound, NotReady, Refused

TREE = {
    "behaviour": {"may_request": ["camera", "seeing"]},
    "camera": {"idle": {"action": "pause"}},
    "lidar": {},
    "arm": {"driver": {}, "conflicts": ["lidar"]},
}


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(TREE, groups={"seeing": {"services": ["camera"]}})
    found.wait(lambda: len(found.containers()) == 4)
    found.settle()
    yield found
    found.close()
    assert not [t for t in threading.enumerate() if t.name == "api-server"], "the server's thread has ended"


@pytest.fixture
def client(robot):
    return robot.client()


def test_a_request_is_served_and_released(robot, client):
    with client.request("camera", wait=20, reason="look"):
        assert robot.active() == {"camera"}
        found = next(r for r in client.requests() if r["reason"] == "look")
        assert found["requester"] == "developer"
        assert 0 < found["expires_in"] <= 10
        assert client.service("camera")["health"] == "Healthy"
        assert client.why("camera")[0]["requests"][0]["reason"] == "look"
    robot.wait(lambda: robot.active() == set())


def test_the_same_id_replaces_and_what_is_released_is_released(robot, client):
    client.request("camera", id="work", ttl=None)
    client.request("lidar", id="work", ttl=None)
    robot.wait(lambda: robot.active() == {"lidar"})
    client.release("work")
    client.release("work")
    robot.wait(lambda: robot.active() == set())


def test_what_cannot_be_is_refused_whole_with_cause_and_remedy(robot, client):
    with pytest.raises(Invalid, match=r"unknown service 'camra'.*try 'camera'"):
        client.request("camera", "camra")
    client.request("lidar", id="first", ttl=None)
    with pytest.raises(Refused, match="conflict"):
        client.request("arm", "camera")
    assert [r["id"] for r in client.requests()] == ["first"]
    with pytest.raises(NotFound):
        client.service("nobody")
    with pytest.raises(NotFound, match="no request of that id"):
        client.call("POST", "/v1/requests/none/renew")
    with pytest.raises(Invalid, match="ttl"):
        client.call("PUT", "/v1/requests/x", {"services": ["camera"], "ttl": "soon"})


@pytest.mark.slow
def test_a_heartbeat_keeps_a_lease_and_without_it_it_ends(robot, client):
    with client.request("camera", ttl=0.6, wait=20):
        client.request("lidar", id="clock", ttl=None)
        seen = {c.service: c.incarnation for c in robot.containers()}
        end = time.monotonic() + 2.0
        wait_for(lambda: time.monotonic() > end)
        assert {c.service: c.incarnation for c in robot.containers()}["camera"] == seen["camera"]
        assert "camera" in robot.active()
    client.call("PUT", "/v1/requests/alone", {"services": ["camera"], "ttl": "500ms"})
    robot.wait(lambda: "camera" in robot.active())
    robot.wait(lambda: "camera" not in robot.active())


def test_waiting_ends_with_the_reason(robot, client):
    client.hold("camera", 60, "calibration")
    client.request("camera", id="look", ttl=None)
    began = time.monotonic()
    with pytest.raises(NotReady, match="calibration"):
        client.wait("camera", timeout=60)
    assert time.monotonic() - began < 30, "what a person holds is not waited for"
    client.unhold("camera")
    client.wait("camera", timeout=20)


def test_events_are_numbered_and_can_be_resumed(robot, client):
    client.request("camera", id="one", ttl=None)
    robot.wait(lambda: "camera" in robot.active())
    first = list(client.events(tail=5))
    assert [e["seq"] for e in first] == sorted(e["seq"] for e in first)
    found: list[dict] = []
    threading.Thread(
        target=lambda: [found.append(e) for e in client.events(cursor=first[-1]["seq"], follow=True)], daemon=True
    ).start()
    client.release("one")
    wait_for(lambda: any(e["kind"] == "release" and e["author"] for e in found))
    assert found[0]["seq"] == first[-1]["seq"] + 1
    missed = list(client.events(cursor=first[0]["seq"]))
    assert [e["seq"] for e in missed][: len(first) - 1] == [e["seq"] for e in first[1:]]


def test_a_driver_is_restarted_only_by_force(robot, client):
    client.request("arm", id="move", wait=20, ttl=None)
    before = robot.container("arm").incarnation
    with pytest.raises(Refused, match="moves hardware"):
        client.restart("arm")
    client.restart("arm", force=True)
    robot.wait(lambda: "arm" in robot.active() and robot.container("arm").incarnation != before)


def test_usage_and_plan_and_status(robot, client):
    client.request("camera", wait=20, ttl=None, id="look")
    usage = client.usage()
    assert usage["services"]["camera"]["memory"] > 0
    assert usage["machine"]["cores"] >= 1
    client.suspend(60, "maintenance")
    client.release("look")
    wait_for(lambda: any(a["verb"] == "pause" for a in client.plan()["actions"]))
    assert "maintenance" in client.status()["suspended"]
    client.unsuspend()
    robot.wait(lambda: "camera" not in robot.active())


def git(folder, *args) -> str:
    return subprocess.run(
        ["git", "-c", "user.name=t", "-c", "user.email=t@localhost", *args],
        cwd=folder,
        check=True,
        capture_output=True,
        text=True,
    ).stdout


def test_manifests_are_validated_written_and_committed(robot, client):
    git(robot.tree, "init", "-q")
    git(robot.tree, "add", "-A")
    git(robot.tree, "commit", "-qm", "all")
    mine = next(m for m in client.manifests() if m["name"] == "lidar")
    text = client.manifest("Service", "lidar")
    with pytest.raises(Invalid, match=r"services/lidar.yaml:.*unknown key"):
        client.put_manifest("Service", "lidar", text.replace("image:", "imagge:"), mine["digest"])
    with pytest.raises(Invalid, match="another kind or name"):
        client.put_manifest("Service", "lidar2", text, None)
    changed = text + "  priority: 70\n"
    after = client.put_manifest("Service", "lidar", changed, mine["digest"], "lidar matters more")
    assert git(robot.tree, "log", "-1", "--format=%s").strip() == "lidar matters more"
    with pytest.raises(Refused, match="changed meanwhile"):
        client.put_manifest("Service", "lidar", text, mine["digest"])
    wait_for(lambda: client.service("lidar")["effective_priority"] == 70)
    client.put_manifest("Service", "radar", text.replace("name: lidar", "name: radar"), None)
    wait_for(lambda: any(s["service"] == "radar" for s in client.services()))
    with pytest.raises(Invalid, match=r"unknown service 'lidar'"):
        client.delete_manifest("Service", "lidar", after["digest"])
    radar = next(m for m in client.manifests() if m["name"] == "radar")
    client.delete_manifest("Service", "radar", radar["digest"])
    wait_for(lambda: all(s["service"] != "radar" for s in client.services()))


def test_one_document_of_a_file_is_changed_and_deleted_alone(robot, client):
    path = robot.tree / "services/lidar.yaml"
    first = path.read_text()
    second = first.replace("name: lidar", "name: radar")
    path.write_text(f"{first}---\n{second}")
    found = {m["name"]: m for m in client.manifests() if m["file"] == "services/lidar.yaml"}
    assert set(found) == {"lidar", "radar"}
    with pytest.raises(Invalid, match="the text has 2 documents; send one at a time"):
        client.put_manifest("Service", "radar", f"{first}---\n{second}", found["radar"]["digest"])
    assert client.manifest("Service", "radar") == f"---\n{second}"
    after = client.put_manifest("Service", "radar", f"{second}  priority: 70\n", found["radar"]["digest"])
    assert path.read_text() == f"{first}---\n{second}  priority: 70\n"
    client.delete_manifest("Service", "radar", after["digest"])
    assert path.read_text() == first


def routes(robot) -> list[tuple[str, str, str]]:
    """(method, path, operation) of every route; each must have an operation."""
    found = []
    for route in robot.server.app.routes:
        if not hasattr(route, "dependant"):
            continue
        marks = [d.call.operation for d in route.dependant.dependencies if hasattr(d.call, "operation")]
        assert len(marks) == 1, f"{route.path} is in no row of the table of permissions"
        path = route.path.replace(":path}", "}")
        found += [(method, path, marks[0]) for method in sorted(route.methods - {"HEAD"})]
    return found


BODIES = {
    "/v1/requests/{id}": {"services": ["camera"]},
    "/v1/holds/{name}": {"duration": "1s"},
    "/v1/suspension": {"duration": "1s"},
    "/v1/manifests/{kind}/{name}": {"text": "x", "base": None},
}


def status_of(socket_path: str, method: str, path: str) -> int:
    """The HTTP status that a caller gets, whoever runs this."""
    from rorg.client import Error

    address = path.replace("{id}", "mine").replace("{name}", "camera").replace("{kind}", "Service")
    if path == "/v1/wait":
        address += "?services=camera&timeout=0"
    try:
        Client(socket_path, patience=0).call(method, address, BODIES.get(path) if method == "PUT" else None)
    except Error as error:
        return error.status
    return 200


def test_a_service_may_what_the_table_says_and_nothing_else(robot, client):
    client.request("behaviour", id="run", wait=20, ttl=None)
    for method, path, operation in routes(robot):
        got = status_of(robot.socket("behaviour"), method, path)
        named = operation not in ("restart", "manifests")  # its manifest names none of these
        may = "service" in OPERATIONS[operation] and named
        assert (got != 403) == may, f"{method} {path} ({operation}): {got}"


def test_nobody_of_the_machine_gets_to_the_sockets_of_services(robot):
    wait_for(lambda: os.path.exists(robot.socket("behaviour")))
    assert os.stat(robot.state.run / "services").st_mode & 0o777 == 0o700
    assert os.stat(robot.socket()).st_mode & 0o777 == 0o660


def test_a_stranger_may_nothing(robot):
    """Another user of the machine, for whom even the socket's mode has been opened."""
    if os.geteuid() != 0:
        pytest.skip("only root can be somebody else")
    os.chmod(robot.socket(), 0o666)
    for folder in (robot.state.path, *robot.state.path.parents):
        if folder != folder.parent and not os.stat(folder).st_mode & 0o001:
            os.chmod(folder, os.stat(folder).st_mode | 0o055)
    paths = [(m, p) for m, p, _ in routes(robot)]
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)
        found = [status_of(robot.socket(), method, path) for method, path in paths]
        os.write(write, json.dumps(found).encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        assert set(json.loads(pipe.read())) == {403}
    os.waitpid(child, 0)


@pytest.mark.slow
def test_a_service_requests_for_itself_and_within_its_manifest(robot, client):
    with pytest.raises(Refused, match="does not run") as refused:
        robot.client("behaviour").request("camera")
    assert "`rorg request behaviour` first" in str(refused.value)
    client.request("behaviour", id="run", wait=20, ttl=None)
    own = robot.client("behaviour")
    own.request("seeing", id="look", wait=20, ttl=None)
    with pytest.raises(Forbidden, match="may restart nothing"):
        own.restart("camera")
    assert next(r for r in own.requests() if r["id"] == "look")["requester"] == "behaviour"
    with pytest.raises(Forbidden, match="may request camera"):
        own.request("lidar")
    with pytest.raises(Forbidden, match="only request for itself"):
        own.request("camera", requester="developer")
    with pytest.raises(Forbidden):
        own.release("run", requester="developer")
    robot.kill("behaviour")
    robot.wait(lambda: [r["id"] for r in client.requests()] == ["run"])


def preview(client: Client, operation: str, *services: str, **more: str) -> dict:
    return client.call("POST", "/v1/preview", {"operation": operation, "services": list(services), **more})


def test_a_preview_is_refused_to_whom_the_operation_is(robot, client):
    client.request("behaviour", id="run", wait=20, ttl=None)
    own = robot.client("behaviour")
    assert preview(own, "request", "seeing")["starts"] == ["camera"]
    for operation, names in (("request", ["lidar"]), ("restart", ["camera"]), ("hold", ["camera"]), ("suspend", [])):
        with pytest.raises(Forbidden):
            preview(own, operation, *names)
    with pytest.raises(Forbidden, match="only request for itself"):
        own.call("POST", "/v1/preview?requester=developer", {"operation": "release", "id": "run"})
    assert [one["service"] for one in preview(client, "hold", "behaviour")["preempted"]] == ["behaviour"]


def test_a_preview_is_refused_for_the_same_reasons_and_changes_nothing(robot, client):
    client.request("lidar", id="first", ttl=None, wait=20)
    with pytest.raises(Refused, match="conflict"):
        preview(client, "request", "arm")
    with pytest.raises(Refused, match="it is not wanted"):
        preview(client, "restart", "camera")
    with pytest.raises(Refused, match="no change of it failed"):
        preview(client, "retry", "camera")
    with pytest.raises(Invalid, match="none is named"):
        preview(client, "hold")
    assert preview(client, "release", id="first")["unwanted"] == ["lidar"]
    client.release("first")
    client.request("arm", id="move", ttl=None, wait=20)
    found = preview(client, "release", id="move")
    assert (found["confirm"], found["confirm_reason"]) == (["arm"], "arm moves hardware")
    assert [r["id"] for r in client.requests()] == ["move"]
    assert client.service("arm")["wanted"]


def test_raw_bytes_neither_stop_nor_slow_the_loop(robot, client):
    dice = random.Random(7)
    held = []
    for n in range(300):
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.connect(robot.socket())
        try:
            if n % 3 == 0:
                connection.sendall(dice.randbytes(dice.randrange(1, 4000)))
            elif n % 3 == 1:
                connection.sendall(b"PUT /v1/requests/x HTTP/1.1\r\nhost: x\r\ncontent-length: 99999\r\n\r\n{")
            else:
                connection.sendall(b"GET /v1/services HTTP/1.1\r\nhost: x\r\n" + b"a: b\r\n" * 50)
        except OSError:
            pass
        held.append(connection)
    with client.request("camera", wait=60):

        def took() -> float:
            began = time.perf_counter()
            client.service("camera")
            return time.perf_counter() - began

        wait_for(lambda: took() < 0.5, what="an answer in half a second, when the machine lets it")
    big = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    big.connect(robot.socket())
    big.sendall(b"PUT /v1/requests/x HTTP/1.1\r\nhost: x\r\ncontent-length: 99999999\r\n\r\n")
    assert b" 413 " in big.recv(200)
    for connection in (*held, big):
        connection.close()


def test_thousands_of_dead_connections_do_not_slow_the_loop(robot, client):
    held = []
    for _ in range(2000):
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.connect(robot.socket())
        held.append(connection)
    with client.request("lidar", wait=60):
        assert robot.active() == {"lidar"}
    for connection in held:
        connection.close()


def test_the_openapi_document_is_current():
    from rorg.api.app import document

    assert json.loads((ROOT / "schemas/openapi.json").read_text()) == document(), "try `make schemas`"


def test_the_client_is_light():
    code = (
        "import sys, time; b = time.perf_counter(); import rorg_client; t = time.perf_counter() - b\n"
        "import importlib.util\n"
        "known = sys.stdlib_module_names | {'rorg_client', '__main__'}\n"
        "own = [m for m in sys.modules if m.split('.')[0] not in known"
        " and not m.startswith(('_', 'sitecustomize', 'distutils'))]\nprint(own, t)"
    )
    path = str(ROOT / "clients/python")
    said = subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path.insert(0, {path!r})\n{code}"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert said.startswith("[] ")


def test_the_async_client(robot):
    import asyncio

    from rorg.client import AsyncClient

    async def look() -> str:
        client = AsyncClient(robot.socket())
        async with client.request("camera", wait=20):
            return (await client.service("camera"))["health"]

    assert asyncio.run(look()) == "Healthy"


RESTLESS = """
import sys, rorg.client as rorg
while True:
    with rorg.request("camera", wait=20):
        pass
"""


@pytest.mark.slow
def test_a_program_killed_at_any_moment_leaves_nothing_behind(tmp_path):
    """It requests, waits and releases without a pause, and is killed at ten random moments of that."""
    dice = random.Random(11)
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    robot.declare(
        {
            "behaviour": {
                "may_request": ["camera"],
                "restart": "never",
                "command": [sys.executable, "-c", RESTLESS],
                "container": {"environment": {"PYTHONPATH": str(ROOT)}},
            },
            "camera": {},
        }
    )
    try:
        for _ in range(10):
            robot.request("behaviour", id="run")
            robot.wait(lambda: any(r.requester == "behaviour" for r in robot.requests()))
            pause = time.monotonic() + dice.uniform(0, 0.3)
            wait_for(lambda pause=pause: time.monotonic() > pause)
            robot.kill("behaviour")
            killed = time.monotonic()
            robot.wait(lambda: not any(r.requester == "behaviour" for r in robot.requests()))
            assert time.monotonic() - killed < 5, "by its end, not by its lease"
            robot.wait(lambda: "camera" not in robot.active())
            robot.release("run")
            robot.settle()
    finally:
        robot.close()
