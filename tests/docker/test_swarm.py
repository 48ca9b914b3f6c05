"""The Swarm engine, on a Swarm of one node; tests/assurance/links has one of three."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from common import BASE_IMAGE, free_port, wait_for
from computers import Computer, Team
from dockerd import Dockerd, chosen, import_base
from robots import WORK, write_tree

from rorg.core.observed import LABEL_OWNER, LABEL_PREVIOUS, LABEL_SERVICE, Container
from rorg.engines.docker.client import Client
from rorg.engines.swarm.engine import SwarmEngine
from rorg.errors import EngineError

pytestmark = [pytest.mark.docker, pytest.mark.docker_only("Podman has no Swarm")]
SPEC = {"image": BASE_IMAGE, "command": WORK, "network_mode": "host", "stop_signal": "SIGINT", "init": True}
SHELL = ["sh", "-c"]


@pytest.fixture(scope="module")
def swarm() -> Iterator[Dockerd]:
    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    if why := chosen().missing():
        pytest.skip(why)
    engine = chosen()(Path(tempfile.mkdtemp(prefix="rorg-dockerd.")))
    engine.start()
    try:
        import_base(engine.host)
        address = f"127.0.0.1:{free_port()}"
        Client(engine.host).post("/swarm/init", {"ListenAddr": address, "AdvertiseAddr": address})
        yield engine
    finally:
        engine.close()


@pytest.fixture
def engine(swarm) -> Iterator[SwarmEngine]:
    made = SwarmEngine("swarm-test", [swarm.host])
    yield made
    for container in made.list():
        made.stop(container.id, "", 5.0)
        made.remove(container.id)
    assert made.list() == []
    assert client(swarm).get("/services") == []
    assert client(swarm).get("/configs") == []
    assert client(swarm).get("/secrets") == []


def client(swarm: Dockerd) -> Client:
    return Client(swarm.host)


def labels(service: str, **more: str) -> dict[str, str]:
    return {LABEL_OWNER: "swarm-test", LABEL_SERVICE: service, **more}


def begin(engine: SwarmEngine, container: str) -> None:
    """Starts it, as the loop does: again if the Swarm was still changing the service that it had just got."""

    def started() -> bool:
        try:
            engine.start(container)
        except EngineError as error:
            if error.kind != "conflict":
                raise
            return False
        return True

    wait_for(started, 30, "the start")


def until(engine: SwarmEngine, container: str, state: str) -> Container:
    def there() -> Container | None:
        found = engine.inspect(container)
        return found if found is not None and found.state == state else None

    return wait_for(there, 30, f"it to be {state}: {engine.inspect(container)}")


def test_a_container_begins_and_ends(engine):
    made = engine.create("planner", SPEC, labels("planner"))
    assert engine.inspect(made).state == "created"
    begin(engine, made)
    running = until(engine, made, "running")
    assert running.node
    assert running.started_at
    engine.stop(made, "SIGINT", 5.0)
    ended = engine.inspect(made)
    assert (ended.state, ended.incarnation) == ("exited", running.incarnation)
    begin(engine, made)
    assert until(engine, made, "running").incarnation != running.incarnation


def test_a_stop_returns_when_the_program_has_ended(engine, swarm):
    """The Swarm calls a service scaled down at once; its program goes on for seconds."""
    made = engine.create("planner", SPEC, labels("planner"))
    begin(engine, made)
    until(engine, made, "running")
    assert len(client(swarm).get("/containers/json")) == 1
    engine.stop(made, "SIGINT", 5.0)
    assert client(swarm).get("/containers/json") == []


def test_a_change_is_one_rolling_update_and_the_previous_container_can_return(engine, swarm):
    first = engine.create("planner", SPEC, labels("planner"))
    begin(engine, first)
    run = until(engine, first, "running")
    service = client(swarm).get("/services")[0]["ID"]
    environment = {**SPEC, "environment": {"EDITION": "2"}}
    second = engine.create("planner.2", environment, labels("planner", **{LABEL_PREVIOUS: first}))
    assert engine.inspect(first).incarnation == run.incarnation, "what was made ends nothing"
    assert engine.inspect(second).state == "created"
    begin(engine, second)
    until(engine, second, "running")
    assert [s["ID"] for s in client(swarm).get("/services")] == [service]
    before = engine.inspect(first)
    assert (before.state, before.incarnation) == ("exited", run.incarnation)
    begin(engine, first)
    until(engine, first, "running")
    assert engine.inspect(second).state == "exited"
    engine.remove(second)
    assert [c.id for c in engine.list()] == [first]


def test_what_ends_on_its_own_comes_again_by_the_swarm(engine):
    made = engine.create("planner", {**SPEC, "command": [*SHELL, "exit 3"]}, labels("planner"))
    begin(engine, made)
    ended = wait_for(lambda: (c := engine.inspect(made)).ended and c, 30, "it to end")
    assert (ended.state, ended.exit_code) == ("restarting", 3)
    wait_for(lambda: engine.inspect(made).incarnation != ended.incarnation, 30, "the Swarm to try again")


@pytest.mark.parametrize(
    ("change", "state", "why"),
    [
        ({"placement": ["node.labels.gpu==yes"]}, "restarting", "no suitable node"),
        ({"image": "rorg.test/none:1"}, "restarting", "No such image"),
        ({"volumes": ["/no/such/place:/x"]}, "restarting", "bind source path does not exist"),
    ],
)
def test_what_cannot_run_says_why(engine, change, state, why):
    made = engine.create("planner", {**SPEC, **change}, labels("planner"))
    begin(engine, made)
    wait_for(lambda: why in engine.inspect(made).error, 30, why)
    assert engine.inspect(made).state == state


def test_files_of_the_tree_travel_with_it(engine, swarm, tmp_path):
    """A file that others may not read is a secret; changed content gets another name."""
    folder = tmp_path / "planner.d"
    (folder / "deep").mkdir(parents=True)
    (folder / "a.yaml").write_text("a: 1\n")
    (folder / "deep/key").write_text("not for others\n")
    (folder / "deep/key").chmod(0o600)
    show = "import signal, sys; print(*(open('/etc/planner/' + n).read() for n in ('a.yaml', 'deep/key')), sep=''); "
    show += "sys.stdout.flush(); signal.pause()"
    mount = {"type": "tree", "source": str(folder), "target": "/etc/planner", "read_only": True}
    made = engine.create("planner", {**SPEC, "command": ["python3", "-c", show], "volumes": [mount]}, labels("planner"))

    def lines() -> list[bytes]:
        return [line.text.strip() for line in engine.log_lines(made, None, None, True) if line.text]

    begin(engine, made)
    wait_for(lambda: lines()[:2] == [b"a: 1", b"not for others"], 30, "its files to be there")
    assert len(client(swarm).get("/configs")) == 1
    assert len(client(swarm).get("/secrets")) == 1
    (folder / "a.yaml").write_text("a: 2\n")
    engine.stop(made, "SIGINT", 5.0)
    begin(engine, made)
    wait_for(lambda: b"a: 2" in lines(), 30, "the changed file")
    other = engine.create("other", SPEC, labels("other"))
    engine.remove(other)
    assert len(client(swarm).get("/configs")) == 1, "what nothing uses is removed"


def test_a_file_that_is_too_large_is_refused_before_anything_changes(engine, tmp_path):
    (tmp_path / "map.pgm").write_bytes(b"0" * (501 << 10))
    mount = {"type": "tree", "source": str(tmp_path), "target": "/maps", "read_only": True}
    made = engine.create("planner", {**SPEC, "volumes": [mount]}, labels("planner"))
    with pytest.raises(EngineError, match=r"map\.pgm"):
        engine.start(made)
    assert engine.inspect(made).state == "created"


def test_a_change_by_somebody_else_meanwhile_is_a_conflict(engine, swarm):
    made = engine.create("planner", SPEC, labels("planner"))
    stale = engine.cluster.look()
    row = stale.service_of(made)
    client(swarm).post(f"/services/{row['ID']}/update", row["Spec"], version=row["Version"]["Index"])
    with pytest.raises(EngineError) as found:
        engine._update("start planner", row, row["Spec"])
    assert found.value.kind == "conflict"


def test_another_robot_of_the_same_swarm_keeps_its_services(engine, swarm):
    other = SwarmEngine("another", [swarm.host], state="/var/lib/another")
    theirs = other.create("planner", SPEC, {**labels("planner"), LABEL_OWNER: "another"})
    assert engine.list() == []
    assert engine.inspect(theirs) is None
    with pytest.raises(EngineError, match="state directory is /var/lib/another") as found:
        engine.create("planner", SPEC, labels("planner"))
    assert found.value.kind == "name_taken"
    other.remove(theirs)


def test_an_engine_that_is_no_manager_is_passed_over(swarm, engine, tmp_path):
    there = SwarmEngine("swarm-test", [f"unix://{tmp_path}/none.sock", swarm.host])
    assert "Swarm of 1 nodes" in there.ping()
    there.pinger().ask()


# -- through rorg ----------------------------------------------------------------------------------------------

ROBOT = {"tour": {"machine": "base", "needs": ["planner"]}, "planner": {"machine": "any", "update": {"bake": "1s"}}}


@pytest.fixture
def team(swarm, tmp_path) -> Iterator[Team]:
    def make(folder: Path, name: str) -> Computer:
        engine = "swarm" if name == "any" else "process"
        return Computer(folder, name, f"127.0.0.1:{free_port()}", engine, swarm.host)

    made = Team(tmp_path, ROBOT, ("base", "any"), make=make)
    made.start()
    yield made
    made.down()
    assert client(swarm).get("/services") == []
    for computer in made.computers.values():
        assert "bug:" not in computer.log.read_text()


def test_a_robot_uses_what_runs_anywhere(team, swarm):
    base, anywhere = team.computers["base"], team.computers["any"]
    base.ask("t", "tour")
    base.wait("tour")
    assert anywhere.state("planner") == "running"
    why = base.rorg("why", "planner").stdout
    assert "planner@any (needed by tour)" in why
    assert "while the network of the Swarm is split, it may run twice" in why
    assert "it runs on " in anywhere.rorg("why", "planner").stdout
    assert "No differences." in anywhere.rorg("diff").stdout
    base.client.release("t")
    wait_for(lambda: anywhere.state("planner") == "exited", 30, "it to idle")
    assert client(swarm).get("/containers/json") == []


def test_a_change_is_rolled_out_and_one_that_fails_is_undone(team, swarm):
    anywhere = team.computers["any"]
    anywhere.ask("p", "planner")
    anywhere.wait("planner")
    planner = ROBOT["planner"]

    def edition() -> str:
        rows = client(swarm).get("/tasks", filters={"desired-state": ["running"]})
        running = [t["Spec"]["ContainerSpec"] for t in rows if t["Status"]["State"] == "running"]
        return next((e for spec in running for e in spec.get("Env") or () if e.startswith("EDITION")), "")

    team.declare({**ROBOT, "planner": {**planner, "container": {"environment": {"EDITION": "2"}}}})
    wait_for(lambda: edition() == "EDITION=2", 30, "the change to run")
    wait_for(lambda: anywhere.client.plan()["waitings"] == [], 30, "it to be proven")
    wait_for(lambda: client(swarm).get("/configs") == [], 30, "the previous container to go")
    bad = {"environment": {"EDITION": "3"}}
    team.declare({**ROBOT, "planner": {**planner, "container": bad, "command": [*SHELL, "exit 4"]}})
    wait_for(lambda: "its change failed" in anywhere.rorg("get").stdout + anywhere.log.read_text(), 60, "it to fail")
    wait_for(lambda: edition() == "EDITION=2", 30, "the previous one to be back")
    wait_for(lambda: anywhere.client.plan()["actions"] == [], 30, "nothing more to do")
    assert len(client(swarm).get("/services")) == 1


@pytest.mark.parametrize("before", ["made", "on trial"])
def test_an_edit_takes_the_place_of_the_previous_one_that_is_not_proven(team, swarm, before):
    anywhere = team.computers["any"]

    def edit(edition: str) -> None:
        planner = {**ROBOT["planner"], "update": {"bake": "4s"}, "container": {"environment": {"EDITION": edition}}}
        team.declare({**ROBOT, "planner": planner})

    def running() -> list[str]:
        rows = client(swarm).get("/tasks", filters={"desired-state": ["running"]})
        specs = [t["Spec"]["ContainerSpec"] for t in rows if t["Status"]["State"] == "running"]
        return [e for spec in specs for e in spec.get("Env") or () if e.startswith("EDITION")]

    edit("1")
    anywhere.ask("p", "planner")
    wait_for(lambda: running() == ["EDITION=1"], 30, "the first edition")
    wait_for(lambda: anywhere.client.plan()["waitings"] == [], 30, "nothing on trial")
    wait_for(lambda: client(swarm).get("/configs") == [], 30, "no container to be parked")
    service = client(swarm).get("/services")[0]["ID"]
    edit("2")
    wait_for(lambda: client(swarm).get("/configs"), 30, "the second edition to be made")
    if before == "on trial":
        wait_for(lambda: running() == ["EDITION=2"], 30, "the second edition to run")
    edit("3")
    wait_for(lambda: running() == ["EDITION=3"], 30, "the third edition in its place")
    wait_for(lambda: client(swarm).get("/configs") == [], 30, "it to be proven")
    failed = [(e["verb"], e["error"]) for e in anywhere.events("failed") if e["service"] == "planner"]
    assert failed == []
    assert [s["ID"] for s in client(swarm).get("/services")] == [service]
    assert anywhere.services()["planner"]["health"] == "Healthy"


def test_what_a_person_has_scaled_is_a_difference_and_is_set_back(team, swarm):
    anywhere = team.computers["any"]
    anywhere.ask("p", "planner")
    anywhere.wait("planner")
    assert anywhere.rorg("suspend", "--for", "1m").returncode == 0
    row = client(swarm).get("/services")[0]
    spec = {**row["Spec"], "Mode": {"Replicated": {"Replicas": 3}}}
    client(swarm).post(f"/services/{row['ID']}/update", spec, version=row["Version"]["Index"])
    wait_for(lambda: "replicas: 3 -> 1" in anywhere.rorg("diff").stdout, 30, "the difference")
    assert anywhere.services()["planner"]["sync"] == "OutOfSync"
    assert anywhere.rorg("suspend", "--end").returncode == 0

    def replicas() -> int:
        return client(swarm).get("/services")[0]["Spec"]["Mode"]["Replicated"]["Replicas"]

    wait_for(lambda: replicas() == 1, 30, "one of it to be left")
    wait_for(lambda: len(client(swarm).get("/containers/json")) == 1, 30, "the others to end")
    wait_for(lambda: "No differences." in anywhere.rorg("diff").stdout, 30, "no difference")


def test_a_killed_rorg_finds_all_again(team, swarm):
    anywhere = team.computers["any"]
    anywhere.ask("p", "planner")
    anywhere.wait("planner")
    run = anywhere.services()["planner"]["incarnation"]
    anywhere.end()
    anywhere.start()
    anywhere.wait("planner")
    assert anywhere.services()["planner"]["incarnation"] == run
    team.declare({**ROBOT, "planner": {**ROBOT["planner"], "container": {"container_name": "lab-planner"}}})

    def names() -> list[str]:
        return sorted(s["Spec"]["Name"] for s in client(swarm).get("/services"))

    wait_for(lambda: names() == ["lab-planner"], 60, "it to have its new name")
    anywhere.wait("planner")


def test_what_crashes_is_started_by_the_swarm_alone_and_ends_when_it_is_no_longer_wanted(team, swarm):
    """A harness found rorg starting it beside the Swarm, and a `down` that could not remove it."""
    anywhere = team.computers["any"]
    network = {"lab": {}}
    crash = {"machine": "any", "profile": "plain", "command": [*SHELL, "exit 3"], "container": {"networks": ["lab"]}}
    machines = {n: {"address": a, "lease": 10.0} for n, a in team.addresses.items()}
    write_tree(team.folder / "manifests", {**ROBOT, "crash": crash}, machines=machines, networks=network)
    wait_for(lambda: "crash" in anywhere.services(), 20, "it to be declared")
    anywhere.ask("c", "crash")
    wait_for(lambda: anywhere.services()["crash"]["crashes"] >= 3, 60, "it to crash three times")
    starts = [e for e in anywhere.events("done") if e["service"] == "crash" and e["verb"] == "start"]
    assert len(starts) == 1
    shown = anywhere.services()["crash"]
    assert (shown["state"], shown["health"]) == ("restarting", "Degraded")
    anywhere.client.release("c")
    wait_for(lambda: anywhere.state("crash") in ("exited", "created"), 30, "it to end")
    team.down()
    assert [n["Name"] for n in client(swarm).get("/networks") if n["Name"] == "lab"] == []


def test_only_the_machine_any_has_a_swarm(team):
    base = team.computers["base"]
    words = ["run", str(base.tree), "--machine", "base", "--engine", "swarm", "--state-dir", str(base.folder / "other")]
    run = subprocess.Popen(
        [sys.executable, "-m", "rorg", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=base.environment,
    )
    try:
        assert run.stdout is not None
        told = next(line for line in run.stdout if "engine of" in line)
    finally:
        run.terminate()
        run.communicate(timeout=30)
    assert "the engine of base cannot be 'swarm'" in told
