"""The Python client against a `rorg run` of its own."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
import threading
import time

import commands
import pytest
from certificates import certificate
from common import ROOT, free_port, wait_for
from rorg_client import AsyncClient, Client, Error, Forbidden, Invalid, Loss, NotReady, Request, Unreachable
from rorg_process import RorgProcess

SERVICES = {
    "camera": {},
    "lidar": {"idle": {"action": "pause"}},
    "arm": {"needs": ["lidar"]},
    "slow": {"ready": {"delay": "2s"}},
    "never": {"ready": {"file": "/nowhere/at/all", "timeout": "600s"}},
    "probed": {"ready": {"exec": ["true"], "interval": "50ms"}},
    "low": {"exclusive": ["gpu"], "priority": 10},
    "high": {"exclusive": ["gpu"], "priority": 90},
    "behaviour": {"may_request": ["camera", "lidar", "arm"], "may_restart": ["camera"], "may_manage": ["lab-*"]},
}


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    found = RorgProcess(tmp_path_factory.mktemp("client"), SERVICES).start()
    wait_for(lambda: all(s["state"] != "none" or s["service"] == "developer" for s in found.client().services()), 60)
    yield found
    found.close()


@pytest.fixture
def robot(running):
    yield running
    client = running.client()
    for request in client.requests():
        client.release(request["id"], request["requester"])


@pytest.fixture
def behaviour(robot):
    """A client on the socket of a service that runs."""
    with robot.client().request("behaviour", wait=20):
        yield robot.client("behaviour")


def ids(robot) -> set[str]:
    return {r["id"] for r in robot.client().requests()}


# -- a request that waits for its answer ------------------------------------------------------------------------


@pytest.mark.slow
def test_a_request_is_kept_while_its_answer_waits_and_released_without_one(robot):
    began, asked = time.monotonic(), []
    caller = threading.Thread(target=lambda: asked.append(robot.client().request("slow", id="long", ttl=0.6, wait=30)))
    caller.start()
    with pytest.raises(NotReady), robot.client().request("never", id="hopeless", ttl=0.6, wait=3):
        raise AssertionError("it is never ready")
    assert time.monotonic() - began >= 3
    assert "hopeless" not in ids(robot)
    caller.join(30)
    assert "long" in ids(robot)
    asked[0].release()
    texts = [e["message"] for e in robot.client().events(tail=200)]
    assert not [t for t in texts if "ran out" in t or "expired" in t]


def test_a_refused_request_leaves_the_earlier_one_of_its_id(robot):
    with robot.client().request("camera", id="mine", wait=20):
        with pytest.raises(Error):
            robot.client().request("no-such-service", id="mine", wait=20)
        assert ids(robot) >= {"mine"}
    assert not [t for t in threading.enumerate() if t.name == "rorg-mine" and t.is_alive()]


# -- asyncio ---------------------------------------------------------------------------------------------------


def test_a_cancelled_wait_releases_at_once(robot):
    async def impatient() -> None:
        async with AsyncClient(robot.socket()).request("never", id="mine", wait=25):
            raise AssertionError("it is never ready")

    async def main() -> float:
        task = asyncio.ensure_future(impatient())
        while "mine" not in await asyncio.to_thread(ids, robot):
            await asyncio.sleep(0.01)
        began = time.monotonic()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert "mine" not in await asyncio.to_thread(ids, robot)
        return time.monotonic() - began

    assert asyncio.run(main()) < 20


def test_a_request_that_is_cancelled_on_its_way_does_not_stay(robot):
    async def main() -> None:
        client = AsyncClient(robot.socket())
        for steps in range(30):  # at whatever it waits for just then
            task = asyncio.ensure_future(client.request("camera", id=f"brief-{steps}", ttl=None).__aenter__())
            for _ in range(steps):
                await asyncio.sleep(0)
            if task.cancel():
                with pytest.raises(asyncio.CancelledError):
                    await task
            else:
                await (await task).release()

    asyncio.run(main())
    assert not [i for i in ids(robot) if i.startswith("brief")]


def test_forty_waits_block_no_other_call(robot):
    async def main() -> float:
        client = AsyncClient(robot.socket())
        async with client.request("never"):
            waits = [asyncio.ensure_future(client.wait("never", timeout=60)) for _ in range(40)]
            await asyncio.sleep(0)
            began = time.monotonic()
            for _ in range(20):
                await client.service("camera")
            took = time.monotonic() - began
            assert not any(w.done() for w in waits)
            for wait in waits:
                wait.cancel()
            await asyncio.wait(waits)
        await client.close()
        return took

    assert asyncio.run(main()) < 30


def test_a_lease_is_kept_as_long_as_the_block_runs(robot):
    async def main() -> None:
        client = AsyncClient(robot.socket())
        async with client.request("camera", wait=20, ttl=0.8) as held:
            run = held.runs["camera"]
            await asyncio.sleep(2.5)
            assert (await client.service("camera"))["incarnation"] == run
            assert [r["id"] for r in await client.requests()] == [held.id]

    asyncio.run(main())


# -- restarts of rorg ------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kill", [False, True], ids=["SIGTERM", "SIGKILL"])
def test_who_waits_goes_on_by_itself_when_rorg_is_ended(robot, kill):
    told: list[str] = []

    def wait() -> None:
        with robot.client().request("slow", id="sync", wait=40):
            told.append("sync")

    async def wait_too() -> None:
        async with AsyncClient(robot.socket()).request("slow", id="async", wait=40):
            told.append("async")

    threads = [threading.Thread(target=wait), threading.Thread(target=lambda: asyncio.run(wait_too()))]
    for thread in threads:
        thread.start()
    wait_for(lambda: ids(robot) >= {"sync", "async"})
    robot.stop(kill)
    robot.start()
    for thread in threads:
        thread.join(60)
    assert sorted(told) == ["async", "sync"]
    wait_for(lambda: not ids(robot))


class Peer:
    """Stands where rorg should: answers each connection with the next of what it was given, and keeps what it heard."""

    def __init__(self, path: str, *answers: bytes) -> None:
        self.heard: list[bytes] = []
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(path)
        self._listener.listen()
        self._thread = threading.Thread(target=self._run, args=(answers,))
        self._thread.start()

    def _run(self, answers: tuple[bytes, ...]) -> None:
        for answer in answers:
            connection, _ = self._listener.accept()
            with connection:
                self.heard.append(connection.recv(65536))
                connection.sendall(answer)

    def close(self) -> None:
        self._thread.join(60)
        self._listener.close()


def told(status: str, body: bytes = b"{}", *headers: str) -> bytes:
    lines = [f"HTTP/1.1 {status}", "content-type: application/json", f"content-length: {len(body)}", *headers, "", ""]
    return "\r\n".join(lines).encode() + body


def test_what_may_not_be_done_twice_is_only_repeated_when_it_did_not_arrive(tmp_path):
    path = str(tmp_path / "rorg.sock")
    later = told("503 Not Now", b'{"code": "busy", "title": "cannot", "cause": "it ends"}', "Retry-After: 1")
    peer = Peer(
        path,
        b"",
        told("200 OK", b"[]"),
        later,
        told("200 OK", b'{"services": ["arm"]}', "rorg-generation: 7"),
        told("200 OK", b"[]"),
        b"",
        later,
    )
    client = Client(path, patience=5)
    assert client.services() == [], "a read whose connection ended is repeated"
    assert client.restart("arm") == ["arm"], "so is a restart that was told to come later"
    client.requests()
    assert b"rorg-not-before: 7" in peer.heard[4]
    with pytest.raises(Unreachable, match="not known whether it was done"):
        client.restart("arm")
    with pytest.raises(Unreachable, match="it ends"):
        Client(path, patience=0).services()
    peer.close()


def test_who_asked_too_much_waits_as_long_as_it_is_told(tmp_path):
    path = str(tmp_path / "rorg.sock")
    much = told("429 Too Many", b'{"code": "too-many-requests", "title": "cannot", "cause": "share"}', "Retry-After: 1")
    peer = Peer(path, much, told("200 OK", b'{"services": ["arm"]}'), much, told("200 OK", b"[]"), much)
    began = time.monotonic()
    assert Client(path, patience=5).restart("arm") == ["arm"], "it was surely not done"
    assert asyncio.run(AsyncClient(path, patience=5).services()) == []
    assert time.monotonic() - began >= 2.0
    with pytest.raises(Unreachable, match="share"):
        Client(path, patience=0.5).services()
    peer.close()


# -- what it reads is not older than what it changed -----------------------------------------------------------


@pytest.mark.slow
def test_a_restart_and_a_changed_manifest_are_waited_for(robot):
    client = robot.client()
    with client.request("camera", wait=20):
        before = client.service("camera")["incarnation"]
        assert client.restart("camera", wait=20) == ["camera"]
        second = client.service("camera")["incarnation"]
        assert second not in ("", before)
        client.restart("camera")
        assert client.wait("camera", timeout=60)["camera"]["incarnation"] not in ("", before, second)
        spec = {"image": "x", "command": ["sh", "-c", "exec sleep 1000"], "idle": {"action": "remove"}}
        for name in ("new-one", "new-one"):
            client.put_service(name, spec)
            with client.request(name, wait=20):
                for seconds in range(1001, 1009):  # while the new container is made, the old one answers still
                    run = client.service(name)["incarnation"]
                    client.put_service(name, {**spec, "command": ["sh", "-c", f"exec sleep {seconds}"]})
                    assert client.wait(name, timeout=60)[name]["incarnation"] not in ("", run)
            client.remove_service(name)
            client.remove_service(name)


def test_readiness_of_each_and_as_a_future(robot):
    client = robot.client()
    with client.request("camera", "never", wait=None) as held, client.request("slow") as other:
        assert other.ready(timeout=30).result(40) is other
        client.wait("camera", timeout=20)
        found = held.readiness()
        assert found["camera"]["ready"]
        assert not found["never"]["ready"]
        assert found["never"]["reason"]
        with pytest.raises(NotReady) as error:
            held.ready(timeout=0.1).result(20)
        assert error.value.services["camera"]["ready"]
        assert "never" in error.value.cause


def test_a_service_with_a_probe_is_told_ready_without_waiting_for_it(robot):
    client = robot.client()

    async def main() -> list[bool]:
        other = AsyncClient(robot.socket())
        found = [(await other.readiness("probed"))["probed"]["ready"] for _ in range(20)]
        async with other.request("probed", wait=0):
            pass
        await other.close()
        return found

    assert not client.readiness("probed")["probed"]["ready"], "nobody requests it"
    with client.request("probed", wait=60) as held:
        assert [held.readiness()["probed"]["ready"] for _ in range(20)] == [True] * 20
        assert asyncio.run(main()) == [True] * 20
        with client.request("probed", wait=0):
            pass
        commands.rorg("wait", "probed", "--timeout", "0s", "--state-dir", str(robot.state))


# -- losses ----------------------------------------------------------------------------------------------------


def test_who_holds_a_request_is_told_what_it_loses(robot, behaviour):
    people, heard = robot.client(), []
    with behaviour.request("arm", wait=20, on_lost=heard.append) as held:
        assert not held.lost.is_set()
        wait_for(lambda: behaviour.watcher._connections)
        people.hold("lidar", 30, "cleaning", force=True)
        wait_for(lambda: {loss.service for loss in heard} == {"arm", "lidar"})
        assert {loss.cause for loss in heard} == {"held"}
        assert held.lost.wait(60)
        assert any("cleaning" in loss.message for loss in heard)
        people.unhold("lidar")
        held.wait(60)
        assert not held.lost.is_set()
        assert not held.losses
        robot.kill_service(people.service("lidar")["pid"])
        wait_for(lambda: [loss.cause for loss in held.losses if loss.service == "lidar"] == ["crashed"])
        held.wait(60)
        people.restart("arm")
        wait_for(lambda: [loss.cause for loss in held.losses] == ["restarted"])
        events = list(behaviour.events(tail=10_000))
        assert {e["kind"] for e in events} >= {"lost", "hold"}
        assert not [e for e in events if e.get("service") == "slow"], "what others do is not its to see"
        assert [e for e in people.events(tail=10_000, mine=True, requester="behaviour") if e["kind"] == "lost"]


def test_why_something_is_lost_is_a_word(robot):
    client = robot.client()
    with client.request("low", wait=20) as held:
        assert not held.lost.is_set()
        wait_for(lambda: client.watcher._connections)
        with client.request("high", wait=20):
            assert held.lost.wait(60)
            assert [loss.cause for loss in held.losses] == ["preempted"]
    spec = {"image": "x", "command": ["sh", "-c", "exec sleep 1000"], "idle": {"action": "remove"}}
    client.put_service("changing", spec)
    with client.request("changing", wait=20) as held:
        assert not held.lost.is_set()
        client.put_service("changing", {**spec, "command": ["sh", "-c", "exec sleep 1001"]})
        assert held.lost.wait(60)
        assert held.losses[0].cause == "replaced"
        held.wait(60)
        client.remove_service("changing")
        assert held.lost.wait(60)
        assert held.losses[0].cause == "ceased"


@pytest.mark.slow
def test_what_was_lost_while_rorg_was_away_is_told_too(robot):
    async def main() -> list[Loss]:
        client = AsyncClient(robot.socket())
        async with client.request("camera", wait=20) as held:
            held.lost.clear()
            pid = (await client.service("camera"))["pid"]
            await asyncio.to_thread(robot.stop)
            await asyncio.to_thread(robot.kill_service, pid)
            robot.start()
            await asyncio.wait_for(held.lost.wait(), 60)
            return held.losses

    assert [loss.service for loss in asyncio.run(main())] == ["camera"]


@pytest.mark.parametrize("cause", ["replaced", pytest.param("crashed", marks=pytest.mark.slow)])
def test_why_it_was_lost_while_rorg_was_away_is_told_once(robot, cause):
    people = robot.client()
    spec = {"image": "x", "command": ["sh", "-c", "exec sleep 1000"], "ready": {"exec": ["true"], "interval": "50ms"}}
    people.put_service("away", spec)
    heard: list[Loss] = []

    async def main(run: str) -> list[Loss]:
        client, told = AsyncClient(robot.socket()), []
        async with client.request("away", wait=60, on_lost=told.append) as other:
            assert other.runs["away"] == run
            pid = people.service("away")["pid"]
            await asyncio.to_thread(robot.stop)
            if cause == "crashed":
                await asyncio.to_thread(robot.kill_service, pid)
            else:
                file = robot.tree / "services/away.yaml"
                file.write_text(file.read_text().replace("sleep 1000", "sleep 1001"))
            robot.start()
            await asyncio.wait_for(other.lost.wait(), 60)
            await other.wait(60)
        await client.close()
        return told

    with people.request("away", wait=60, on_lost=heard.append) as held:
        run = held.runs["away"]
        found = asyncio.run(main(run))
        wait_for(lambda: heard)
        held.wait(60)
        assert [(loss.cause, loss.incarnation) for loss in found] == [(cause, run)]
        assert [(loss.cause, loss.incarnation) for loss in heard] == [(cause, run)]
    people.remove_service("away")


def test_a_release_ends_what_waits_for_its_services(robot):
    held = robot.client().request("never")
    future = held.ready(timeout=3600)
    held.release()
    with pytest.raises(NotReady, match="was released"):
        future.result(60)
    with pytest.raises(NotReady, match="was released"):
        held.ready(timeout=3600).result(60)

    async def main() -> None:
        other = await AsyncClient(robot.socket()).request("never")
        task = other.ready(timeout=3600)
        await asyncio.sleep(0)
        await other.release()
        with pytest.raises(NotReady, match="was released"):
            await asyncio.wait_for(task, 60)

    asyncio.run(main())


@pytest.mark.parametrize("call", ["request", "wait", "readiness"])
def test_a_list_of_services_is_told_to_be_an_argument_too_many(robot, call):
    with pytest.raises(Invalid, match=r"argument 1 is a list.*named one by one"):
        getattr(robot.client(), call)(["camera", "lidar"])

    async def main() -> None:
        with pytest.raises(Invalid, match="argument 2 is a tuple"):
            await getattr(AsyncClient(robot.socket()), call)("slow", ("camera",))

    asyncio.run(main())


def test_a_loss_that_overtakes_the_answer_is_not_forgotten():
    held = Request(Client("/nowhere"), ["camera"], "mine", None, "", None, None)
    assert Loss("camera", "held", "by a person").message == Loss("camera", "held", "by a person").reason
    old, new = Loss("camera", "held", "", "run 1"), Loss("camera", "crashed", "", "run 2")
    told = {"camera": {"ready": True, "incarnation": "run 2", "reason": ""}}
    held.note(old)
    assert not held.ready_now(told, known=1)
    assert not held.losses
    held.note(old)
    held.note(new)
    assert held.ready_now(told, known=0)
    assert held.losses == [new]


# -- processes -------------------------------------------------------------------------------------------------

FORKED = """
import os, sys
from rorg_client import Client
client = Client(sys.argv[1])
with client.request("camera", id="parents", wait=20, ttl=2) as held:
    child = os.fork()
    if child:
        assert os.waitpid(child, 0)[1] == 0
        assert [r["id"] for r in client.requests()] == ["parents"], client.requests()
    else:
        held.release()
        with client.request("lidar", id="childs"):
            assert len(client.requests()) == 2
if child:
    assert not client.requests()
"""


def test_a_forked_child_that_leaves_the_block_releases_nothing_of_its_parent(robot):
    done = subprocess.run([sys.executable, "-c", FORKED, robot.socket()], timeout=60, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


# -- services that manage services -----------------------------------------------------------------------------


def test_a_service_manages_what_its_manifest_lets_it(robot, behaviour):
    spec = {"image": "x", "command": ["sh", "-c", "exec sleep 1000"], "needs": ["lidar"]}
    behaviour.put_service("lab-probe", spec)
    with behaviour.request("lab-probe", wait=20):
        run = behaviour.service("lab-probe")["incarnation"]
        assert behaviour.restart("lab-probe", wait=20) == ["lab-probe"]
        assert behaviour.service("lab-probe")["incarnation"] != run
        behaviour.put_service("lab-probe", {**spec, "priority": 10})
        assert [m["name"] for m in behaviour.manifests()] == ["lab-probe"]
        assert "priority" in behaviour.manifest("Service", "lab-probe")
    (robot.tree / "robot.env").write_text("SPEED=5\n")
    for name, more in (
        ("other", {}),
        ("lab-x", {"driver": {}}),
        ("lab-x", {"container": {"privileged": True}}),
        ("lab-x", {"container": {"volumes": ["/:/host"]}}),
        ("lab-x", {"needs": ["slow"]}),
        ("lab-x", {"conflicts": ["camera"]}),
        ("lab-x", {"priority": 51}),
        ("lab-x", {"priority": "${NONE:-51}"}),
        ("lab-x", {"priority": "${NONE:-5}", "container": {"privileged": True}}),
        ("lab-x", {"may_manage": ["*"]}),
        ("lab-x", {"may_restart": ["lidar"]}),
        ("lab-x", {"mounts": ["../services:/x"]}),
        ("lab-x", {"always_on": True}),
    ):
        with pytest.raises(Forbidden):
            behaviour.put_manifest("Service", name, manifest(name, {**spec, **more}), None)
    with pytest.raises(Forbidden):
        behaviour.put_manifest("Policy", "lab-policy", manifest("lab-policy", {}), None)
    with pytest.raises(Forbidden):
        behaviour.manifest("Service", "camera")
    with pytest.raises(Forbidden):
        behaviour.delete_manifest("Service", "camera", "0")
    behaviour.remove_service("lab-probe")
    assert not behaviour.manifests()


def manifest(name: str, spec: dict) -> str:
    from rorg_client import manifest_text

    return manifest_text("Service", name, spec)


# -- TLS -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_clients_and_commands_go_over_tls_with_a_certificate(tmp_path):
    for name, authority in (("authority", ""), ("robot", "authority"), ("ada", "authority"), ("stranger", "")):
        certificate(tmp_path, name, authority)
    port = free_port()
    robot = RorgProcess(
        tmp_path,
        {"camera": {}},
        "--listen",
        f"127.0.0.1:{port}",
        *(
            word
            for kind, file in (("cert", "robot.pem"), ("key", "robot.key"), ("ca", "authority.pem"))
            for word in (f"--tls-{kind}", str(tmp_path / file))
        ),
    ).start()
    files = {"ca": str(tmp_path / "authority.pem"), "cert": str(tmp_path / "ada.pem"), "key": str(tmp_path / "ada.key")}
    address = f"https://127.0.0.1:{port}"

    async def main() -> str:
        client = AsyncClient(address, **files)
        async with client.request("camera", wait=20) as held:
            robot.process.kill()
            robot.process.wait()
            robot.start()
            await held.wait(60)
            assert [e async for e in client.events(tail=1)]
            return (await client.service("camera"))["health"]

    try:
        with Client(address, **files).request("camera", id="over", wait=30) as held:
            assert held.client.service("camera")["health"] == "Healthy"
        assert asyncio.run(main()) == "Healthy"
        with pytest.raises(Unreachable):
            Client(
                address,
                patience=0.0,
                ca=files["ca"],
                cert=str(tmp_path / "stranger.pem"),
                key=str(tmp_path / "stranger.key"),
            ).services()
        names = {f"RORG_{kind.upper()}": file for kind, file in files.items()}
        for words, code, said in (
            (["request", "camera", "--id", "cli", "--wait"], 0, "request 'cli'"),
            (["get", "services", "camera"], 0, "Healthy"),
            (["restart", "camera", "--wait"], 0, "camera"),
            (["release", "cli"], 0, "released"),
            (["diff", str(robot.tree)], 5, "RORG_ADDRESS"),
        ):
            done = commands.rorg(*words, code=code, cwd=robot.tree.parent, RORG_ADDRESS=address, **names)
            assert said in done.stdout + done.stderr, (words, done.stdout, done.stderr)
    finally:
        robot.close()


# -- the package -----------------------------------------------------------------------------------------------

EVERYWHERE = """
import asyncio, sys
import rorg_client as rorg
client = rorg.Client(sys.argv[1])
with client.request("camera", wait=20, on_lost=print) as held:
    assert client.service("camera")["health"] == "Healthy" and not held.lost.is_set()
    assert held.ready().result(20) is held

async def main():
    client = rorg.AsyncClient(sys.argv[1])
    async with client.request("camera", wait=20) as held:
        assert (await held.readiness())["camera"]["ready"] and not held.lost.is_set()
        await client.restart("camera", wait=20)
        await asyncio.wait_for(held.lost.wait(), 60)
        task = asyncio.ensure_future(client.request("never", wait=25).__aenter__())
        await asyncio.sleep(0.2)
        task.cancel()
        await asyncio.wait([task])
    assert [e async for e in client.events(tail=3)]
    await client.close()

asyncio.run(main())
assert not client.requests()
"""


def pythons() -> list[str]:
    """The oldest and the newest at hand."""
    folders = sorted(
        (ROOT.home() / ".pyenv/versions").glob("3.*"), key=lambda p: [int(n) for n in p.name.split(".") if n.isdigit()]
    )
    found = [str(f / "bin/python") for f in folders if [int(n) for n in f.name.split(".")[:2]] >= [3, 8]]
    return [found[0], found[-1]] if found else [sys.executable]


@pytest.mark.parametrize("python", pythons())
def test_it_works_on_old_and_new_pythons(robot, python):
    done = subprocess.run(
        [python, "-W", "error", "-c", EVERYWHERE, robot.socket()],
        timeout=90,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT / "clients/python")},
    )
    assert done.returncode == 0, done.stderr


def test_it_is_imported_in_no_time():
    code = "import time; b = time.perf_counter(); import rorg_client; print(time.perf_counter() - b)"
    wait_for(
        lambda: (
            float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)
            < 0.04
        ),
        60,
        "an import in 40 ms, if the machine lets it",
    )


MISSPELT = """
import rorg_client as rorg

rorg.request("camera", waiit=20)
rorg.client().request("camera", prioritty=20)
rorg.AsyncClient().request("camera", waiit=20)
rorg.client().service("camera")["helth"]
rorg.client().wait("camera", timout=2)
"""


def test_mypy_takes_the_examples_and_no_misspelt_keyword(tmp_path):
    wrong = tmp_path / "misspelt.py"
    wrong.write_text(MISSPELT)
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "mypy",
            "--strict",
            "--cache-dir",
            str(tmp_path / "cache"),
            "--no-error-summary",
            str(ROOT / "clients/python/rorg_client"),
            *map(str, sorted((ROOT / "clients/python/examples").glob("*.py"))),
            str(wrong),
        ],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    errors = [line for line in done.stdout.splitlines() if ": error:" in line]
    assert [int(line.split(":")[1]) for line in errors] == [4, 5, 6, 7, 8], done.stdout + done.stderr
    assert all(line.startswith("misspelt.py:") for line in errors)


def test_types_are_those_of_the_api():
    from rorg_client import types

    from rorg.api.app import document

    schemas = document()["components"]["schemas"]
    same = {
        "ServiceView": "ServiceView",
        "ConditionView": "Condition",
        "RequestView": "RequestView",
        "Why": "Why",
        "Usage": "Usage",
        "ServiceUsage": "ServiceUsage",
        "ManifestView": "ManifestView",
        "GroupView": "GroupView",
    }
    for schema, name in same.items():
        known = set(getattr(types, name).__annotations__) | {"generation"}
        assert set(schemas[schema]["properties"]) | {"generation"} == known, f"{name} is not {schema}"


def test_an_error_keeps_what_it_says_when_it_is_sent_to_another_process():
    import pickle

    error = pickle.loads(pickle.dumps(NotReady("cannot x", "y", "z", "not-ready", 504)))
    assert isinstance(error, Error)
    assert (error.cause, error.status) == ("y", 504)


def test_stop_names_who_holds_what_goes_on_running(robot):
    folder = ("--state-dir", str(robot.state))
    with robot.client().request("arm", id="tour", wait=60):
        told = commands.rorg("stop", "arm", *folder, code=1).stderr
        assert "rorg: cannot stop arm: request 'tour' of developer holds it; try `rorg release tour`" in told
        told = commands.rorg("stop", "lidar", *folder, code=1).stderr
        assert "cannot stop lidar: " in told
        assert "tour" in told
        robot.client().request("arm", id="arm", ttl=None)
        told = commands.rorg("stop", "arm", *folder, code=1)
        assert "request 'arm' of developer released" in told.stdout + told.stderr
        assert "request 'tour' of developer holds it" in told.stderr
    assert "nothing to release" in commands.rorg("stop", "arm", *folder).stderr
    assert "nothing to release" in commands.rorg("stop", "nothing", *folder).stderr
