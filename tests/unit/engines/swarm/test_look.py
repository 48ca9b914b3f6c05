"""What a look at the Swarm means: nodes that are lost, programs that end, two of one service."""

from __future__ import annotations

from typing import Any

import pytest

from rorg.core.observed import LABEL_SERVICE, Container
from rorg.engines.swarm.body import CONTAINER, service_spec
from rorg.engines.swarm.look import ENDED, STARTED, Look, read_parked, read_tasks
from rorg.engines.swarm.managers import NoQuorum, check_quorum
from rorg.model.probe import Probe
from rorg.probes.ask import at

ID = "c0ffee"


def node(name: str, state: str = "ready") -> dict[str, Any]:
    return {"Description": {"Hostname": name}, "Status": {"State": state, "Addr": f"10.0.0.{len(name)}"}}


def task(number: int, state: str, on: str = "one", desired: str = "running", code: int | None = None) -> dict[str, Any]:
    return {
        "ID": f"t{number}",
        "ServiceID": "s",
        "CreatedAt": f"2026-01-01T00:00:0{number}Z",
        "DesiredState": desired,
        "NodeID": on,
        "Spec": {"ContainerSpec": {"Labels": {CONTAINER: ID}}},
        "Status": {
            "State": state,
            "Err": "gone" if state == "failed" else "",
            "ContainerStatus": {"ExitCode": code, "ContainerID": "x"},
        },
    }


def seen(
    tasks: list[dict[str, Any]], replicas: int = 1, down: tuple[str, ...] = (), restart: str = "always", **labels: str
) -> Container:
    spec = service_spec("planner", {"image": "x", "restart": restart}, {LABEL_SERVICE: "planner", **labels}, ID)
    spec["Mode"]["Replicated"]["Replicas"] = replicas
    at = "2026-01-01T00:00:00Z"
    row = {"ID": "s", "Spec": spec, "CreatedAt": at, "UpdatedAt": at, "Version": {"Index": 1}}
    nodes = {name: node(name, "down" if name in down else "ready") for name in ("one", "two")}
    found = Look(0.0, (row,), {}, read_tasks(tasks), nodes).container(ID)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("tasks", "down", "state", "started"),
    [
        ([], (), "restarting", ""),
        ([task(1, "pending")], (), "restarting", "1"),
        ([task(1, "starting")], (), "restarting", "1"),
        ([task(1, "running")], (), "running", "1"),
        ([task(1, "failed", desired="shutdown", code=3), task(2, "ready", desired="ready")], (), "restarting", "1"),
        ([task(1, "failed", desired="shutdown", code=3), task(2, "running")], (), "running", "2"),
        ([task(1, "running", desired="shutdown")], ("one",), "restarting", ""),
        ([task(1, "running", desired="shutdown"), task(2, "preparing", "two")], ("one",), "restarting", "2"),
        ([task(1, "running", desired="shutdown"), task(2, "running", "two")], ("one",), "running", "2"),
        ([task(1, "running", desired="shutdown"), task(2, "running", "two")], (), "running", "2"),
    ],
)
def test_a_container_that_is_to_run(tasks, down, state, started):
    found = seen(tasks, down=down)
    assert (found.state, found.started_at[18:19]) == (state, started)


@pytest.mark.parametrize(
    ("restart", "state", "shown"),
    [
        ("always", "failed", "restarting"),
        ("always", "complete", "restarting"),
        ("on-failure", "failed", "restarting"),
        ("on-failure", "complete", "exited"),
        ("no", "failed", "exited"),
        ("no", "rejected", "exited"),
    ],
)
def test_what_has_ended_comes_again_if_the_swarm_starts_it_again(restart, state, shown):
    """So rorg counts the end, and starts nothing beside the Swarm."""
    code = {"failed": 3, "complete": 0, "rejected": None}[state]
    found = seen([task(1, state, desired="shutdown", code=code)], restart=restart)
    assert (found.state, found.exit_code, found.ended) == (shown, 125 if code is None else code, True)


def test_a_node_that_is_lost_may_still_run_it():
    found = seen([task(1, "running", desired="shutdown"), task(2, "running", "two")], down=("one",))
    assert (found.node, found.address) == ("two", "10.0.0.3")
    assert found.error == "it may run a second time on one, which does not answer"
    assert seen([task(1, "running")]).error == ""


@pytest.mark.parametrize(
    ("tasks", "labels", "state", "started", "code"),
    [
        ([], {}, "created", "", None),
        ([], {STARTED: "2026-01-01T00:00:05Z", ENDED: "3"}, "exited", "5", 3),
        ([task(1, "running", desired="remove")], {}, "running", "1", None),
        ([task(1, "pending", desired="remove")], {}, "created", "", None),
    ],
)
def test_a_container_that_is_not_to_run(tasks, labels, state, started, code):
    found = seen(tasks, replicas=0, **labels)
    assert (found.state, found.started_at[18:19], found.exit_code) == (state, started, code)


def test_what_ended_before_the_last_start_says_nothing_of_it():
    old = {**task(1, "failed", desired="shutdown", code=3), "CreatedAt": "2025-12-31T00:00:01Z"}
    assert seen([old, task(2, "preparing")]).state == "restarting"


def test_what_cannot_be_read_is_not_ours():
    row = {"ID": "c", "CreatedAt": "", "Spec": {"Data": ""}}
    assert (
        read_parked([row, {**row, "Spec": {"Data": "W10="}}, {**row, "Spec": {"Data": "eyJMYWJlbHMiOiB7fX0="}}]) == {}
    )


@pytest.mark.parametrize(
    ("states", "most"),
    [(("reachable",), True), (("reachable", "reachable", "unreachable"), True), (("reachable", "unreachable"), False)],
)
def test_most_managers_must_answer(states, most):
    nodes = [{"ManagerStatus": {"Reachability": state}} for state in states]
    worker = {"Status": {"State": "ready"}}
    if most:
        check_quorum([*nodes, worker])
    else:
        with pytest.raises(NoQuorum):
            check_quorum([*nodes, worker])


@pytest.mark.parametrize(
    ("kind", "target", "host", "there"),
    [
        ("tcp", "127.0.0.1:80", "10.0.0.2", "10.0.0.2:80"),
        ("tcp", "localhost:80", "fd00::1", "[fd00::1]:80"),
        ("http", "http://localhost:8080/health?x=1", "10.0.0.2", "http://10.0.0.2:8080/health?x=1"),
        ("http", "http://localhost/", "10.0.0.2", "http://10.0.0.2/"),
    ],
)
def test_a_probe_asks_the_node(kind, target, host, there):
    assert at(Probe(kind, target), host).target == there
