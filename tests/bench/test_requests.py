"""A request of one of 41 services beside the engine's own call, in turn, as a program makes it: `make bench`."""

from __future__ import annotations

import os
import statistics

import docker
import pytest
from common import BASE_IMAGE, wait_for
from robots import WORK
from rorg_process import RorgProcess
from rows import Row, Side, Table, alternating, milliseconds, states

ROUNDS = 25
GOALS = {"pause": ("paused", 1.3), "stop": ("stopped", 1.1), "remove": ("absent", 1.0)}


@pytest.fixture(scope="module")
def robot(dockerd, tmp_path_factory):
    specs: dict[str, dict] = {f"s{n:02}": {"always_on": True} for n in range(38)}
    specs |= {action: {"idle": {"action": action, "linger": 0}} for action in GOALS}
    made = RorgProcess(tmp_path_factory.mktemp("requests"), specs, docker=dockerd.host).start()
    wait_for(lambda: os.path.exists(made.socket()), 30)
    names = [f"s{n:02}" for n in range(38)]
    made.client().wait(*names, timeout=120)
    yield made
    made.close()


@pytest.mark.parametrize("action", GOALS)
def test_a_request_to_ready(dockerd, robot, action):
    client, api = robot.client(), docker.APIClient(dockerd.host, version="auto")
    how, goal = GOALS[action]

    def create() -> str:
        return api.create_container(BASE_IMAGE, WORK, host_config=api.create_host_config(network_mode="host"))["Id"]

    bare = [create()]
    api.start(bare[0])
    away = {
        "pause": api.pause,
        "stop": lambda one: api.kill(one),
        "remove": lambda one: api.remove_container(one, force=True),
    }

    def appear() -> None:
        if action == "pause":
            api.unpause(bare[0])
        elif action == "stop":
            api.start(bare[0])
        else:
            bare[0] = create()
            api.start(bare[0])

    held = []

    def request() -> None:
        held.append(client.request(action, wait=30))

    def release() -> None:
        held.pop().release()
        wait_for(
            lambda: client.service(action)["state"] not in ("running", "stopping") and client.plan()["actions"] == []
        )

    request()
    release()
    away[action](bare[0])
    running = states(dockerd.host)["running"] + 1
    ours, theirs = alternating(
        ROUNDS,
        Side(request, release, dockerd.host, running),
        Side(appear, lambda: away[action](bare[0]), dockerd.host, running),
    )
    Table().add(Row(f"request of {how} service to ready, 41 services", ours, "ms", goal, theirs, "bare call"))
    if action != "remove":
        appear()
    if action == "pause" or action == "stop":
        api.remove_container(bare[0], force=True)


def test_what_is_active_already(robot):
    """Without any call of the engine: all of it is ours."""
    client = robot.client()
    client.request("s00", wait=30).release()
    found = [milliseconds(lambda: client.request("s00", wait=30).release()) for _ in range(ROUNDS)]
    Table().add(Row("request, wait and release of an active service", statistics.median(found), "ms", 5))
