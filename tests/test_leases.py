"""The moment at which a lease runs out, against renewals and changes of the file that come at the same moment.

The loop is stepped by hand, so that the order of things is certain.
"""

from __future__ import annotations

import time

import pytest
from conftest import wait_for
from robots import write_tree

from rorg.core.observed import Container, Observed
from rorg.daemon.rights import Caller
from rorg.daemon.robot import Robot
from rorg.daemon.wiring import make_engine, make_loop
from rorg.errors import Missing
from rorg.manifest.catalog import Request
from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir

DEVELOPER = Caller("developer")


class Stepped:
    """A loop without threads over an engine that shows what it is told, and the file as another process sees it."""

    def __init__(self, folder) -> None:
        state = StateDir(folder / "state").prepare()
        self.loop = make_loop(write_tree(folder / "tree", {"camera": {}, "lidar": {}, "mission": {}}), state,
                              make_engine("process", state), lambda line: None)
        self.robot, self.file = Robot(self.loop, {}), RequestsFile(state.requests)
        self.show()

    def show(self, *containers: Container) -> None:
        self.loop.observer.snapshot = lambda: Observed(containers, True)

    def step(self, read: bool = True) -> None:
        """One pass; with `read`, the loop has heard of changes of the file."""
        self.loop._files = self.loop._asked = read
        self.loop.one_pass()

    def put(self, *services: str, **more) -> None:
        self.file.change(lambda asked: asked.put(Request("look", "developer", services, **more)))

    def asked(self) -> tuple[Request, ...]:
        self.file.read()
        return self.file.asked.requests


@pytest.fixture
def stepped(tmp_path):
    found = Stepped(tmp_path)
    found.robot.committer.start()
    yield found
    found.robot.committer.stop()


def run_out(stepped, seconds: float) -> None:
    began = time.monotonic()
    wait_for(lambda: time.monotonic() > began + seconds)


@pytest.mark.parametrize("change", [{"renewed": "1"}, {"ttl": 60.0}, {"services": ("lidar",)}])
def test_what_was_changed_on_disk_meanwhile_is_not_dropped(stepped, change):
    stepped.put("camera", ttl=0.2)
    stepped.step()
    run_out(stepped, 0.25)
    services = change.pop("services", ("camera",))
    stepped.put(*services, **{"ttl": 0.2, **change})
    stepped.step(read=False)
    assert [r.services for r in stepped.asked()] == [services]


def test_what_was_not_changed_is_dropped(stepped):
    stepped.put("camera", ttl=0.2)
    stepped.step()
    run_out(stepped, 0.25)
    stepped.step(read=False)
    assert stepped.asked() == ()


def test_what_was_renewed_while_the_pass_decided_is_not_dropped(stepped):
    stepped.put("camera", ttl=0.2)
    stepped.step()
    run_out(stepped, 0.25)
    change = stepped.loop.requests.change

    def renewed_first(edit):
        stepped.robot.renew(DEVELOPER, ("developer", "look"))
        return change(edit)

    stepped.loop.requests.change = renewed_first
    stepped.step(read=False)
    assert len(stepped.asked()) == 1


def test_what_is_being_dropped_cannot_be_renewed(stepped):
    stepped.put("camera", ttl=0.2)
    stepped.step()
    run_out(stepped, 0.25)
    change = stepped.loop.requests.change

    def renewed_amid(edit):
        def both(asked):
            found = edit(asked)
            with pytest.raises(Missing):
                stepped.robot.renew(DEVELOPER, ("developer", "look"))
            return found
        return change(both)

    stepped.loop.requests.change = renewed_amid
    stepped.step(read=False)
    assert stepped.asked() == ()
    with pytest.raises(Missing):
        stepped.robot.renew(DEVELOPER, ("developer", "look"))


def test_a_request_put_again_at_once_after_its_release_gets_its_whole_lease(stepped):
    stepped.step()
    request = Request("look", "developer", ("camera",), ttl=0.4)
    stepped.robot.put_request(DEVELOPER, request).result(5)
    stepped.step()
    run_out(stepped, 0.3)
    stepped.robot.release(DEVELOPER, request.key).result(5)
    stepped.robot.put_request(DEVELOPER, request).result(5)
    stepped.step()
    run_out(stepped, 0.2)
    stepped.step()
    assert len(stepped.asked()) == 1


def test_a_request_that_is_replaced_while_it_is_bound_keeps_its_new_services(stepped):
    run = Container("m" * 64, "mission", "mission", "running", "2026-01-01T00:00:00Z")
    stepped.step()
    stepped.show(run)
    stepped.file.change(lambda asked: asked.put(Request("go", "mission", ("camera",))))
    change = stepped.loop.requests.change

    def replaced_first(edit):
        stepped.loop.requests.change = change
        stepped.file.change(lambda asked: asked.put(Request("go", "mission", ("lidar",))))
        return change(edit)

    stepped.loop.requests.change = replaced_first
    stepped.step()
    found, = stepped.asked()
    assert (found.services, found.incarnation) == (("lidar",), run.incarnation)
