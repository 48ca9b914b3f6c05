"""The requests file: the moment at which a lease runs out, against renewals and changes of the file that come at the
same moment; and mistakes in it, which forget nothing and end nothing.

The loop is stepped by hand, so that the order of things is certain.
"""

from __future__ import annotations

import subprocess
import time
from dataclasses import replace

import pytest
from common import wait_for
from hypothesis import given
from hypothesis import strategies as st
from robots import write_tree

from rorg.api.changes import release
from rorg.api.operations import Operations
from rorg.api.permissions import Caller
from rorg.core.observed import Container, Observed
from rorg.daemon.wiring import make_loop
from rorg.engines.make import make_engine
from rorg.errors import Busy, Invalid, Missing
from rorg.model.catalog import Hold, Request
from rorg.model.diagnostics import Where
from rorg.model.units import SHORTEST_LEASE
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_file import RequestsFile
from rorg.store.requests_parser import parse, render
from rorg.store.state_dir import StateDir

DEVELOPER = Caller("developer")


class Stepped:
    """A loop without threads over an engine that shows what it is told, and the file as another process sees it."""

    def __init__(self, folder) -> None:
        self.folder, state = folder, StateDir(folder / "state").prepare()
        self.loop = make_loop(
            write_tree(folder / "tree", {"camera": {}, "lidar": {}, "mission": {}}),
            state,
            make_engine("process", state),
            lambda line: None,
        )
        self.robot, self.file = Operations(self.loop), RequestsFile(state.requests)
        self.show()

    def show(self, *containers: Container) -> None:
        self.loop.observer.snapshot = lambda: Observed(containers, True)

    def step(self, read: bool = True) -> None:
        """One pass; with `read`, the loop has heard of changes of the file."""
        if read:
            self.loop.wakes.files_changed()
        else:
            self.loop.wakes.take_files(), self.loop.wakes.take_requests()
        self.loop.one_pass()

    def put(self, *services: str, **more) -> None:
        self.file.change(lambda document: document.put(Request("look", "developer", services, **more)))

    def asked(self) -> tuple[Request, ...]:
        self.file.read()
        return self.file.document.requests


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
    change = stepped.loop.leases.file.change

    def renewed_first(edit):
        stepped.robot.renew(DEVELOPER, ("developer", "look"))
        return change(edit)

    stepped.loop.leases.file.change = renewed_first
    stepped.step(read=False)
    assert len(stepped.asked()) == 1


def test_what_was_released_cannot_be_renewed_though_the_loop_has_not_heard_of_it(stepped):
    stepped.put("camera", ttl=60.0)
    stepped.step()
    stepped.robot.change(DEVELOPER, release(("developer", "look"))).result(5)
    with pytest.raises(Missing):
        stepped.robot.renew(DEVELOPER, ("developer", "look"))
    stepped.robot.put_request(DEVELOPER, Request("look", "developer", ("camera",), ttl=60.0)).result(5)
    stepped.robot.renew(DEVELOPER, ("developer", "look"))
    stepped.file.change(lambda document: document.without({("developer", "look")}))
    with pytest.raises(Missing):
        stepped.robot.renew(DEVELOPER, ("developer", "look"))


def test_what_is_being_dropped_cannot_be_renewed(stepped):
    stepped.put("camera", ttl=0.2)
    stepped.step()
    run_out(stepped, 0.25)
    change = stepped.loop.leases.file.change

    def renewed_amid(edit):
        def both(document):
            found = edit(document)
            with pytest.raises(Missing):
                stepped.robot.renew(DEVELOPER, ("developer", "look"))
            return found

        return change(both)

    stepped.loop.leases.file.change = renewed_amid
    stepped.step(read=False)
    assert stepped.asked() == ()
    with pytest.raises(Missing):
        stepped.robot.renew(DEVELOPER, ("developer", "look"))


def test_a_refused_request_does_not_renew_the_one_that_it_would_have_replaced(stepped):
    stepped.put("camera", ttl=30.0)
    stepped.step()
    before = stepped.loop.leases.renewals()
    with pytest.raises(Invalid, match="nosuch"):
        stepped.robot.put_request(DEVELOPER, Request("look", "developer", ("nosuch",), ttl=30.0)).result(10)
    assert stepped.loop.leases.renewals() == before
    stepped.robot.put_request(DEVELOPER, Request("look", "developer", ("lidar",), ttl=30.0)).result(10)
    assert stepped.loop.leases.renewals() != before


def test_while_the_first_tree_is_read_no_service_is_said_to_be_missing(tmp_path):
    (tmp_path / "tree").mkdir()
    subprocess.run(["git", "init", "-q", str(tmp_path / "tree")], check=True)
    (tmp_path / "tree/.git/index.lock").touch()
    stepped = Stepped(tmp_path)
    stepped.step()
    asks = [lambda: stepped.robot.service_text("camera"), lambda: stepped.robot.current.members("camera")]
    for ask in asks:
        with pytest.raises(Busy):
            ask()
    (tmp_path / "tree/.git/index.lock").unlink()
    wait_for(lambda: stepped.loop.tree.read() and stepped.loop.tree.loaded)
    for ask in asks:  # it has been read, and no pass has looked at it yet
        with pytest.raises(Busy):
            ask()
    stepped.step()
    for ask in asks:
        assert ask()


def test_a_request_put_again_at_once_after_its_release_gets_its_whole_lease(stepped):
    stepped.step()
    request = Request("look", "developer", ("camera",), ttl=0.4)
    stepped.robot.put_request(DEVELOPER, request).result(5)
    stepped.step()
    run_out(stepped, 0.3)
    stepped.robot.change(DEVELOPER, release(request.key)).result(5)
    stepped.robot.put_request(DEVELOPER, request).result(5)
    stepped.step()
    run_out(stepped, 0.2)
    stepped.step()
    assert len(stepped.asked()) == 1


def test_a_request_that_is_replaced_while_it_is_bound_keeps_its_new_services(stepped):
    run = Container("m" * 64, "mission", "mission", "running", "2026-01-01T00:00:00Z")
    stepped.step()
    stepped.show(run)
    stepped.file.change(lambda document: document.put(Request("go", "mission", ("camera",))))
    change = stepped.loop.leases.file.change

    def replaced_first(edit):
        stepped.loop.leases.file.change = change
        stepped.file.change(lambda document: document.put(Request("go", "mission", ("lidar",))))
        return change(edit)

    stepped.loop.leases.file.change = replaced_first
    stepped.step()
    (found,) = stepped.asked()
    assert (found.services, found.incarnation) == (("lidar",), run.incarnation)


def test_a_lease_that_ran_out_stays_so_while_that_cannot_be_written_down(stepped):
    stepped.put("camera", ttl=0.2)
    stepped.step()
    run_out(stepped, 0.25)
    good = stepped.file.path.read_text()
    stepped.file.path.write_text(good + "requests: again\n")
    for _ in range(3):
        stepped.step()
        assert "camera" not in stepped.loop.decision.situation.wanted
        run_out(stepped, 0.1)
    stepped.file.path.write_text(good)
    stepped.step()
    assert stepped.asked() == ()


def again(stepped) -> Stepped:
    """Another rorg on the same state directory."""
    return Stepped(stepped.folder)


def test_a_mistake_in_the_file_forgets_nothing_over_a_restart_of_rorg(stepped):
    stepped.put("camera")
    stepped.step()
    good = stepped.file.path.read_text()
    stepped.file.path.write_text(good + "requests: again\n")
    stepped.step()
    other = again(stepped)
    other.step()
    assert "camera" in other.loop.decision.situation.wanted
    stepped.file.path.write_text("requests: []\n")
    other.step()
    assert "camera" not in other.loop.decision.situation.wanted
    third = again(stepped)
    third.step()
    assert "camera" not in third.loop.decision.situation.wanted


def test_a_lease_is_renewed_while_the_file_is_broken_after_a_restart_of_rorg_too(stepped):
    stepped.put("camera", ttl=60.0)
    stepped.step()
    stepped.file.path.write_text(stepped.file.path.read_text() + "requests: again\n")
    stepped.step()
    other = again(stepped)
    other.step()
    assert other.robot.renew(DEVELOPER, ("developer", "look"))["id"] == "look"


def test_while_nothing_is_known_of_what_was_asked_nothing_is_changed(stepped):
    stepped.file.path.write_text("requests: 5\n")
    stepped.show(Container("c" * 64, "camera", "camera", "running", "2026-01-01T00:00:00Z"))
    stepped.step()
    decision = stepped.loop.decision
    assert "the requests file has an error" in decision.situation.suspended
    assert decision.plan.actions
    assert not decision.begin
    stepped.file.path.write_text("requests: [{id: x, services: [camera]}]\n")
    stepped.step()
    assert not stepped.loop.decision.situation.suspended


@pytest.mark.parametrize(
    "text",
    [
        "requests: [{id: x, services: 5}]",
        "requests: [{id: x, services: true}]",
        "requests: [{id: x, services: {a: b}}]",
        "restarts: {camera: 0001-01-01T00:00:00+14:00}",
        "holds: {camera: {until: 9999-12-31T23:59:59-14:00}}",
        "restarts: {camera: year 0}",
        "requests: [{id: [x], services: [camera]}]",
        "suspended: {until: {}}",
        "requests: [{id: x, services: [camera], ttl: 1e300s}]",
        "holds: 5",
        "requests: [{id: x, services: [camera], priority: 101}]",
        "requests: [{id: x, services: [camera], priority: -1}]",
        "requests: [{id: x, services: [camera], priority: true}]",
        "restarts: [camera]",
    ],
)
def test_whatever_is_wrong_in_the_file_is_told_with_its_place_and_ends_nothing(stepped, text):
    stepped.put("camera")
    stepped.step()
    stepped.file.path.write_text(text + "\n")
    stepped.step()
    assert stepped.loop.leases.file.diagnostics
    assert "requests.yaml:1" in str(stepped.loop.leases.file.diagnostics[0])
    assert "camera" in stepped.loop.decision.situation.wanted


def test_a_hold_of_a_thousand_years_is_slept_through(stepped):
    stepped.file.path.write_text("holds: {camera: {until: '9999-12-31T00:00:00Z'}}\n")
    stepped.step()
    stepped.loop.wake()
    stepped.loop._sleep(stepped.loop.decision)


TEXTS = st.one_of(
    st.text(max_size=12),
    st.sampled_from(
        [
            "12e4567",
            "0o17",
            "1_000",
            "0x1F",
            "1:30",
            "yes",
            "NO",
            "null",
            "~",
            "2026-01-31",
            ".5",
            "-",
            "a: b",
            "#x",
            "'",
            "=",
            "!x",
            "&a",
            "*a",
            "1e3",
            "\n",
            " x ",
            "<<",
            "\x85",
            "\u2028",
            "\ufeff",
        ]
    ),
)


@pytest.mark.slow
@given(
    st.lists(
        st.builds(
            Request,
            id=TEXTS.filter(bool),
            requester=TEXTS.filter(bool),
            services=st.lists(TEXTS.filter(bool), min_size=1, max_size=3).map(tuple),
            reason=TEXTS,
            incarnation=st.none() | TEXTS.filter(bool),
            priority=st.none() | st.integers(0, 100),
            ttl=st.none() | st.floats(SHORTEST_LEASE, 1e8),
            renewed=TEXTS,
        ),
        max_size=3,
        unique_by=lambda r: r.key,
    ),
    st.dictionaries(TEXTS.filter(bool), st.builds(Hold, st.floats(0, 2e11), TEXTS), max_size=2),
)
def test_what_is_written_is_read_again(requests, holds):
    document = RequestsDocument(tuple(requests), {}, holds, None)
    again, diagnostics = parse(render(document), "requests.yaml")
    assert diagnostics == []
    assert [replace(r, where=Where("")) for r in again.requests] == [
        replace(r, ttl=r.ttl and pytest.approx(r.ttl)) for r in requests
    ]
    assert {n: (pytest.approx(h.until, abs=1e-3), h.reason) for n, h in again.holds.items()} == {
        n: (h.until, h.reason) for n, h in holds.items()
    }
