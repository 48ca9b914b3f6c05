"""The sim engine speaks the whole protocol: what follows an engine, and what asks its containers, work on it."""

from __future__ import annotations

import pytest
from common import wait_for

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.core.schedule import Target
from rorg.engines.observe import Observer
from rorg.engines.protocol import Engine, Usage
from rorg.errors import EngineError
from rorg.model.probe import Probe
from rorg.probes.answer import YES
from rorg.probes.runner import ProbeRunner
from rorg.tools.sim.engine import SimEngine


@pytest.fixture
def sim():
    found = SimEngine("me", lambda: found.now)
    found.now = 0.0
    return found


@pytest.fixture
def camera(sim) -> str:
    made = sim.create("camera", {"image": "x"}, {LABEL_OWNER: "me", LABEL_SERVICE: "camera"})
    sim.start(made)
    return made


def test_an_observer_follows_it(sim, camera):
    engine: Engine = sim
    observer = Observer(engine, lambda: None, lambda: 60.0)
    observer.start()
    try:
        wait_for(lambda: [c.state for c in observer.snapshot().containers] == ["running"])
        lists = observer.lists
        for change, state in ((sim.pause, "paused"), (sim.resume, "running"), (sim.kill, "exited")):
            change(camera)
            wait_for(lambda state=state: [c.state for c in observer.snapshot().containers] == [state])
        sim.remove(camera)
        wait_for(lambda: observer.snapshot().containers == ())
        assert observer.lists == lists, "events told it all"
    finally:
        observer.stop()


def test_it_uses_what_it_needs_while_it_runs(sim, camera):
    sim.needs["camera"] = 0.5, 100
    sim.now = 4.0
    sim.pause(camera)
    sim.now = 10.0
    assert sim.usage(sim.list()) == {camera: Usage(2.0, 100)}
    sim.resume(camera)
    sim.now = 12.0
    assert sim.usage(sim.list()) == {camera: Usage(3.0, 100)}
    sim.kill(camera)
    assert sim.usage(sim.list()) == {}
    sim.start(camera)
    assert sim.usage(sim.list()) == {camera: Usage(0.0, 100)}


def test_its_containers_can_be_asked(sim, camera):
    ask = ProbeRunner(sim, lambda service: sim.inspect(camera))
    sim.answers["ill",] = 3, b"no\n"

    def answer(kind, target):
        return ask(("camera", "ready"), Target(Probe(kind, target), sim.inspect(camera).incarnation, 1.0))

    assert answer("exec", ("well",)) == YES
    assert answer("exec", ("ill",)).message == "exec ill exits 3: no"
    sim.say(camera, b"now serv")
    assert not answer("log", "serving").ok
    sim.say(camera, b"ing\n")
    assert answer("log", "serving") == YES
    assert not answer("file", "/etc/passwd").asked, "a file of this machine is none of its"
    sim.kill(camera)
    with pytest.raises(EngineError, match="it is exited"):
        sim.exec(camera, ["well"], 1.0)


def test_the_output_of_the_run_before_is_in_its_logs_only(sim, camera):
    sim.say(camera, b"one\ntwo\n")
    sim.kill(camera)
    sim.start(camera)
    sim.say(camera, b"three\n")
    assert [line.text for line in sim.log_lines(camera, 2, None, False)] == [b"two\n", b"three\n"]
    assert list(sim.log_since(camera, "")) == [(b"three\n", "14")]
    assert list(sim.log_since(camera, "14")) == [(b"", "14")]
