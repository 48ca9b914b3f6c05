"""Stop signals that do not exist: manifests refuse them, and a container that has one all the same is ended."""

from __future__ import annotations

import pytest
from common import BASE_IMAGE, wait_for
from robots import write_tree

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.engines.make import make_engine
from rorg.manifest.load import load
from rorg.model.signals import signal_number
from rorg.store.state_dir import StateDir

ODD = ["99", "0", "-1", "SIGFOO", "SIGRTMIN+40", "²", "9" * 400]
LIVES = [
    "python3",
    "-S",
    "-c",
    "import signal\nfor n in (1, 2): signal.signal(n, lambda *_: None)\nwhile True: signal.pause()",
]


@pytest.mark.parametrize("name", [*ODD, "32", "33", "65", "SIG", "", "INT\n", "SIGINT SIGTERM"])
def test_a_manifest_with_an_odd_signal_is_refused_at_its_place(tmp_path, name):
    tree = write_tree(tmp_path, {"camera": {"container": {"stop_signal": name}}})
    (error,) = load(tree).errors
    assert "camera.yaml" in str(error)
    assert "is not a signal; write SIGINT or SIGTERM" in str(error)


@pytest.mark.parametrize("name", ["99", "SIGFOO"])
def test_a_signal_that_a_profile_fills_in_is_refused_too(tmp_path, name):
    tree = write_tree(
        tmp_path,
        {"camera": {"profile": "odd"}},
        profiles={"odd": {"container": {"stop_signal": name}}},
    )
    assert any("is not a signal" in str(error) for error in load(tree).errors)


@pytest.mark.parametrize("name", ["SIGRTMIN", "RTMIN+15", "rtmax-14", "64", "34", "SIGPOLL"])
def test_real_time_signals_are_signals(tmp_path, name):
    catalog = load(write_tree(tmp_path, {"camera": {"container": {"stop_signal": name}}})).catalog
    assert 29 <= signal_number(catalog.services["camera"].spec["stop_signal"]) <= 64


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.docker)])
def engine(request, tmp_path, monkeypatch):
    if request.param == "docker":
        monkeypatch.setenv("DOCKER_HOST", request.getfixturevalue("dockerd").host)
    found = make_engine(request.param, StateDir(tmp_path / "state").prepare())
    yield found
    for container in found.list():
        if container.alive:
            found.stop(container.id, "SIGKILL", 10.0)
        found.remove(container.id)


@pytest.mark.parametrize(("name", "paused"), [("99", False), ("SIGFOO", True)], ids=["running", "paused"])
def test_what_the_engine_refuses_is_passed_over(engine, name, paused):
    """A number such as an image may declare: the sequence goes on to SIGTERM, which gets the grace, and to SIGKILL."""
    labels = {LABEL_OWNER: engine.owner, LABEL_SERVICE: "x", "rorg.io/spec": "", "rorg.io/declared": ""}
    spec = {"image": BASE_IMAGE, "command": LIVES, "network_mode": "host", "stop_signal": "99"}
    made = engine.create("odd-signal", spec, labels)
    engine.start(made)
    wait_for(lambda: engine.inspect(made).state == "running")
    if paused:
        engine.pause(made)
    engine.stop(made, name, 2.0)
    assert engine.inspect(made).state == "exited"
