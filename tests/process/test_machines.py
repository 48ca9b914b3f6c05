"""A robot of two computers: real `rorg run` processes, TLS, and the process engine."""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from common import wait_for
from computers import LEASE, Computer, Team
from rorg_client import Client, Error

HOST = {"image": "host", "command": "sleep infinity"}
TOUR = {
    "tour": {**HOST, "machine": "base", "needs": ["navigation"]},
    "navigation": {**HOST, "machine": "base", "needs": ["localization"]},
    "localization": {**HOST, "machine": "jetson", "needs": ["camera"]},
    "camera": {**HOST, "machine": "jetson"},
}


@pytest.fixture
def team(tmp_path) -> Iterator[Team]:
    made = Team(tmp_path, TOUR)
    made.start()
    yield made
    made.down()


def both(team: Team) -> tuple[Computer, Computer]:
    return team.computers["base"], team.computers["jetson"]


@pytest.mark.slow
def test_a_request_reaches_the_other_computer_and_its_release_too(team):
    base, jetson = both(team)
    base.ask("t1", "tour")
    base.wait("tour", timeout=20)
    assert jetson.state("localization") == jetson.state("camera") == "running"
    assert base.ready("localization")
    assert jetson.ready("localization")
    chain = [link["text"] for link in base.why("camera")["chain"]]
    assert chain == [
        "camera@jetson (needed by localization)",
        "localization@jetson (needed by navigation)",
        "navigation@base (needed by tour)",
        "tour@base (requested by developer (t1))",
        "developer (meta-service)",
    ]
    there = [link["text"] for link in jetson.why("camera")["chain"]]
    assert there[3] == "tour@base (requested by developer (t1@base))"
    began = time.monotonic()
    base.wait("localization")
    assert time.monotonic() - began < 3, "a question alone is passed on"
    table = base.rorg("get").stdout
    assert "MACHINE" in table
    assert table.count("jetson") == 2
    assert [line.split()[:2] for line in base.rorg("get", "machines").stdout.splitlines()[1:]] == [
        ["base", "this"],
        ["jetson", "up"],
    ]
    for line in ("exec camera -- true", "hold camera --for 1s", "restart camera"):
        done = base.rorg(*line.split())
        assert done.returncode in (4, 5), done.stderr
        assert "camera belongs to the machine jetson; try the same command on jetson" in done.stderr
    done = base.rorg("logs", "camera")
    assert "camera belongs to the machine jetson; try `--on jetson`" in done.stderr
    base.client.release("t1")

    def ended() -> list[str]:
        """By the journal, which follows the state."""
        return [e["service"] for e in jetson.events("state") if e["state"] not in ("ready", "running", "created")]

    wait_for(lambda: jetson.state("camera") != "running" and len(ended()) == 2, 20, "the camera to stop")
    assert ended() == ["localization", "camera"], "dependants first"


@pytest.mark.slow
def test_one_computer_shows_what_the_other_one_knows(team):
    base, jetson = both(team)
    base.ask("t1", "tour")
    base.wait("tour")
    for line in (
        "get -o name",
        "why camera",
        "timeline camera",
        "logs camera",
        "events --tail 5",
        "top --once",
        "diff",
    ):
        done = base.rorg(*line.split(), "--on", "jetson")
        assert done.returncode == 0, (line, done.stderr)
    assert "camera" in base.rorg("timeline", "camera", "--on", "jetson", "-o", "json").stdout
    follow = [sys.executable, "-m", "rorg", "events", "-f", "--on", "jetson"]
    with subprocess.Popen(follow, env=base.environment, stdout=subprocess.PIPE, text=True) as following:
        jetson.client.call(
            "PUT", "/v1/holds", {"services": ["camera"], "duration": "10m", "reason": "dust", "force": True}
        )
        assert following.stdout is not None
        assert any("dust" in line for line in following.stdout)
        following.kill()
    for line, told in (
        ("hold camera --for 1s --on jetson", "from another machine, rorg only reads"),
        ("get --on nosuch", "knows no other machine of that name"),
    ):
        done = base.rorg(*line.split())
        assert done.returncode == 5, done.stderr
        assert told in done.stderr
    jetson.end()
    done = base.rorg("get", "--on", "jetson")
    assert done.returncode == 3, done.stderr
    assert "cannot ask jetson" in done.stderr


@pytest.mark.slow
def test_a_lost_computer_is_told_before_its_lease_ends_and_nothing_is_stopped_by_the_link(team):
    base, jetson = both(team)
    base.ask("t1", "tour")
    jetson.ask("look", "camera")
    base.wait("tour", timeout=20)
    runs = {n: jetson.services()[n]["incarnation"] for n in ("localization", "camera")}
    base_runs = base.services()["navigation"]["incarnation"]
    stopped = time.monotonic()
    base.end(signal.SIGSTOP)
    wait_for(lambda: jetson.state("localization") != "running", 3 * LEASE, "the lease to end")
    assert LEASE - 4 < time.monotonic() - stopped < 2 * LEASE
    assert jetson.services()["camera"]["incarnation"] == runs["camera"], "its own request keeps it"
    base.end(signal.SIGCONT)
    base.wait("tour", timeout=30)
    assert base.services()["navigation"]["incarnation"] == base_runs
    lost = [e for e in base.events("lost") if e["service"] == "localization"]
    assert lost
    assert lost[-1]["cause"] in ("unreachable", "unready")


@pytest.mark.slow
def test_what_a_silent_computer_runs_is_unknown_and_what_needs_it_waits(team):
    base, jetson = both(team)
    base.ask("t1", "tour")
    base.wait("tour", timeout=20)
    run = jetson.services()["localization"]["incarnation"]
    jetson.end()
    wait_for(lambda: base.state("localization") == "unknown", 2 * LEASE, "the state to be unknown")
    status = base.services()["localization"]
    assert status["health"] == "Unknown"
    assert "jetson, which does not answer" in status["message"]
    lost: list[str] = []
    wait_for(
        lambda: lost.extend(e["cause"] for e in base.events("lost") if e["service"] == "localization") or lost,
        LEASE,
        "the event, which is kept after the pass that shows the state",
    )
    assert lost[0] == "unreachable"
    with pytest.raises(Error, match="jetson"):
        base.wait("localization", timeout=1)
    assert base.state("navigation") == "running", "nothing is stopped because of a link"
    base.client.release("t1")
    base.ask("t2", "navigation")
    jetson.start()
    base.wait("navigation", timeout=30)
    assert jetson.services()["localization"]["incarnation"] == run, "rorg's restart stops nothing"


@pytest.mark.slow
def test_a_restart_of_the_requester_keeps_what_it_asked_for(team):
    base, jetson = both(team)
    base.ask("t1", "tour")
    base.wait("tour", timeout=20)
    run = jetson.services()["localization"]["incarnation"]
    base.end()
    base.start()
    base.wait("tour", timeout=30)
    assert jetson.services()["localization"]["incarnation"] == run


@pytest.mark.slow
def test_a_computer_with_a_new_state_directory_is_heard_again(team):
    """The others remember an rorg of it with a higher number, and refuse what is older."""
    base, jetson = both(team)
    for _ in range(3):
        base.end()
        base.start()
    base.end()
    (base.folder / "machine.json").unlink()
    base.start()
    base.ask("t1", "tour")
    base.wait("tour", timeout=30)
    assert jetson.state("localization") == "running"
    assert any("jetson knows a later rorg of base" in e["message"] for e in base.events("superseded"))


@pytest.mark.slow
def test_a_service_moves_by_a_change_of_the_manifest_and_never_runs_twice(team):
    base, jetson = both(team)
    base.ask("t1", "tour")
    base.wait("tour", timeout=20)
    team.declare({**TOUR, "navigation": {**TOUR["navigation"], "machine": "jetson"}})
    wait_for(lambda: jetson.services()["navigation"]["machine"] == "jetson", 20, "the manifest")
    wait_for(lambda: jetson.ready("navigation"), 30, "navigation to run on jetson")
    wait_for(lambda: base.ready("tour"), 30, "tour to be ready")
    team.declare(TOUR)
    wait_for(lambda: base.services()["navigation"]["machine"] == "base", 20, "the manifest")
    wait_for(lambda: base.ready("navigation") and base.ready("tour"), 30, "navigation to be back")
    spans = []
    for computer in (base, jetson):
        told = [(e["at"], e["state"]) for e in computer.events("state") if e["service"] == "navigation"]
        began = ""
        for at, state in [*told, ("9999", "none")]:
            if state in ("running", "ready") and not began:
                began = at
            elif state not in ("running", "ready") and began:
                spans.append((began, at))
                began = ""
    spans.sort()
    assert len(spans) == 3
    assert all(one[1] <= other[0] for one, other in itertools.pairwise(spans)), spans


@pytest.mark.slow
def test_a_moved_service_waits_for_its_former_computer_or_a_person(tmp_path):
    team = Team(tmp_path, TOUR)
    base, jetson = both(team)
    team.start()
    try:
        base.ask("t1", "localization")
        base.wait("localization", timeout=20)
        jetson.end()
        team.declare({**TOUR, "camera": {**TOUR["camera"], "machine": "base"}})
        wait_for(lambda: base.client.call("GET", "/v1/services/camera")["machine"] == "base", 20, "the manifest")
        assert base.why("camera")["waits"] == ["jetson, where it may still run, has not answered"]
        assert jetson.rorg("take", "camera").returncode != 0
        done = base.rorg("take", "camera", "--yes")
        assert done.returncode == 0, done.stderr
        base.ask("t2", "camera")
        base.wait("camera", timeout=20)
        assert any(e["service"] == "camera" for e in base.events("taken"))
        # It was not true, and the computer comes back with old manifests.
        jetson.tree = team.declare(TOUR, "old")
        jetson.start()
        wait_for(lambda: base.events("runs-twice"), 30, "the mistake to be told")
        assert base.events("runs-twice")[-1]["service"] == "camera"
    finally:
        team.down()


@pytest.mark.slow
def test_a_computer_is_taken_down_although_services_of_another_one_need_what_it_runs(team):
    """A person's word ends its leases, and the other computer is told what it has lost."""
    base, jetson = both(team)
    base.ask("t1", "tour")
    base.wait("tour")
    run = base.services()["navigation"]["incarnation"]
    done = jetson.rorg("down", "--yes", "--timeout", "30s")
    assert done.returncode == 0, done.stderr
    wait_for(lambda: any(e["service"] == "localization" for e in base.events("lost")), 10, "the loss")
    assert base.services()["navigation"]["incarnation"] == run, "nothing stops because of a link"
    jetson.start()
    base.wait("tour")
    assert jetson.ready("camera")


@pytest.mark.slow
def test_a_service_restarts_with_one_that_it_needs_on_another_computer(team):
    """As ROS nodes must with the master."""
    base, jetson = both(team)
    need = {"service": "localization", "restart": True}
    team.declare({**TOUR, "navigation": {**TOUR["navigation"], "needs": [need]}})
    wait_for(lambda: len(base.events("tree-accepted")) > 1, 20, "the need to be in force")
    base.ask("t1", "tour")
    base.wait("tour")
    run = base.services()["navigation"]["incarnation"]
    jetson.client.restart("localization", wait=20)
    wait_for(lambda: base.services()["navigation"]["incarnation"] not in ("", run), 20, "navigation to restart")
    base.wait("tour")
    wait_for(lambda: base.client.plan()["actions"] == [], 20, "nothing more to do")


@pytest.mark.slow
def test_a_certificate_says_which_computer_may_speak(team):
    base, jetson = both(team)

    def call(name: str, method: str, path: str, body: object = None) -> object:
        files = {
            "cert": str(team.folder / f"certificates/{name}.pem"),
            "key": str(team.folder / f"certificates/{name}.key"),
        }
        authority = str(team.folder / "certificates/authority.pem")
        return Client(f"https://{jetson.address}", ca=authority, **files).call(method, path, body)

    renewal = {"machine": "base", "boot": "x", "incarnation": 10**9, "number": 1, "since": 1, "duration": 10}
    for name, path in (("jetson", "/v1/machines/base/renewal"), ("base", "/v1/machines/jetson/renewal")):
        with pytest.raises(Error, match="cannot speak for"):
            call(name, "PUT", path, renewal)
    with pytest.raises(Error, match="for 3600"):
        call("base", "PUT", "/v1/machines/base/renewal", {**renewal, "duration": 3600})
    for method, path in (("DELETE", "/v1/requests/x"), ("PUT", "/v1/down"), ("POST", "/v1/services/camera/restart")):
        with pytest.raises(Error, match=r"may not|cannot"):
            call("base", method, path)
    authority = str(team.folder / "certificates/authority.pem")
    made = base.rorg("certificate", "--person", "ada", "--into", str(team.folder / "certificates"))
    assert made.returncode == 0, made.stderr
    assert call("ada", "GET", "/v1/status")
    files = {}
    for kind in ("pem", "key"):
        kept = team.folder / f"ada.{kind}"
        kept.write_bytes((team.folder / f"certificates/ada.{kind}").read_bytes())
        files["cert" if kind == "pem" else "key"] = str(kept)
    done = base.rorg("certificate", "--revoke", "ada", "--into", str(team.folder / "certificates"))
    assert done.returncode == 0, done.stderr

    def refused() -> bool:
        try:
            Client(f"https://{jetson.address}", patience=0, ca=authority, **files).call("GET", "/v1/status")
        except Error:
            return True
        return False

    wait_for(refused, 10, "the revoked certificate to be refused")
