"""The machine's clock is set: back by NTP on a robot without a battery, or ahead. Nothing that rorg decides depends on
it."""

from __future__ import annotations

import os
from dataclasses import replace

import pytest
from common import wait_for
from editions import edition
from robots import VirtualRobot, handed_on
from updates import later, running

from rorg.core.holds import Moment, adjusted, begin_hold, seconds_left
from rorg.core.observed import Container
from rorg.engines.docker.inspection import began
from rorg.host.clock import process_start
from rorg.model.catalog import Hold
from rorg.model.probe import Probe
from rorg.model.units import stamp
from rorg.probes.files import FileProbes
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_parser import parse, render

STEPS = (-50 * 365 * 86400.0, -3600.0, -20.0, 20.0, 3600.0, 50 * 365 * 86400.0)
"""Seconds by which the clock is set."""


@pytest.fixture
def virtual(tmp_path):
    return VirtualRobot(tmp_path)


@pytest.mark.parametrize("seconds", STEPS)
def test_a_good_change_after_the_clock_was_set_is_kept(virtual, seconds):
    virtual.declare(edition("old"))
    virtual.settle()
    virtual.sim.clock_set = seconds
    virtual.declare(edition("new"))
    digest = virtual.sim.desired.digests["arm"]
    virtual.settle()
    assert running(virtual, "arm").digest == digest
    assert not virtual.sim.memory.of("arm").update.failed


@pytest.mark.parametrize("seconds", STEPS)
def test_a_bad_change_after_the_clock_was_set_is_undone(virtual, seconds):
    virtual.declare(edition("old"))
    virtual.settle()
    old = running(virtual, "arm").id
    virtual.sim.clock_set = seconds
    virtual.declare(edition("bad"))
    virtual.sim.faults.bad[virtual.sim.desired.digests["arm"]] = "exit"
    later(virtual, 30)
    assert running(virtual, "arm").id == old
    assert virtual.sim.memory.of("arm").update.failed == "ended with exit code 1"


# -- holds and suspensions -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seconds", STEPS)
@pytest.mark.parametrize("again", ["", "rorg", "machine"], ids=["", "rorg begins again", "the machine boots"])
def test_a_hold_lasts_as_long_as_was_asked_for(virtual, seconds, again):
    virtual.declare({"arm": {"always_on": True}})
    virtual.settle()
    virtual.hold("arm", 100)
    virtual.wait(lambda: virtual.active() == set(), 10)
    virtual.sim.clock_set = seconds
    if again:
        if again == "machine":
            virtual.sim.boot = "next"
        virtual.sim.reborn(handed_on(virtual.sim.decision, rebooted=again == "machine"))
        virtual.change(lambda asked: replace(asked, holds={"arm": adjusted(asked.holds["arm"], virtual.moment())}))
    if again == "machine" and seconds > 0:
        pytest.skip("it cannot be told from a machine that was off for so long")
    later(virtual, 85)
    assert virtual.active() == set()
    later(virtual, 20)
    assert virtual.active() == {"arm"}


def test_a_hold_that_began_in_1970_lasts_after_a_reboot():
    held = begin_hold(Moment(60.0, 60.0, "first"), 5.0)
    assert seconds_left(held, Moment(1.8e9, 20.0, "second")) == 5.0
    now = adjusted(held, Moment(1.8e9, 20.0, "second"))
    assert (now.until, now.uptime, now.boot) == (1.8e9 + 5.0, 25.0, "second")
    assert seconds_left(now, Moment(0.0, 26.0, "second")) == -1.0


def test_what_a_person_writes_by_hand_ends_by_the_clock():
    held = Hold(1000.0, "until noon")
    assert seconds_left(held, Moment(990.0, 5.0, "any")) == 10.0
    assert adjusted(held, Moment(9.0, 5.0, "any")) is held


def test_a_hold_is_read_as_it_was_written():
    held = begin_hold(Moment(1.75e9, 12.25, "5e0c"), 90.0, "the arm is open")
    document = RequestsDocument(holds={"arm": held}, suspended=replace(held, reason=""))
    assert parse(render(document), "requests.yaml") == (document, [])
    for bad in ("{until: 2026-01-01T00:00:00Z, duration: long}", "{until: 2026-01-01T00:00:00Z, uptime: 5, more: 1}"):
        assert parse(f"holds: {{arm: {bad}}}\n", "requests.yaml")[1]


# -- files -----------------------------------------------------------------------------------------------------


KEY = ("arm", "ready", 0)


def test_a_file_of_this_run_is_no_older_although_the_clock_was_set_ahead(tmp_path):
    """The run and its file are from 1970. By the present clock the process began today, after it wrote the file."""
    path = tmp_path / "ready"
    path.touch()
    probe = Probe("file", str(path))
    os.utime(path, (60.0, 60.0))
    asked = FileProbes().ask(KEY, probe, os.getpid(), False, "1970-01-01T00:00:50Z")
    assert asked.ok, asked
    earlier = FileProbes().ask(KEY, probe, os.getpid(), False, "1970-01-01T00:01:10Z")
    assert earlier.message == f"file {path} is older than this run"


@pytest.mark.parametrize("seconds", [0.0, *STEPS])
def test_output_is_read_from_the_start_of_the_run_although_the_clock_was_set(seconds):
    """The engine's log has the times of the clock as it was: what is read from later on is nothing, and what is read
    from much earlier is the output of the run before."""
    noted = process_start(os.getpid()) + 0.1 - seconds
    found = began(Container("id", "arm", "arm", "running", pid=os.getpid(), started_at=stamp(noted)))
    assert noted - 2.0 < found <= noted


@pytest.mark.parametrize("seconds", [-1000.0, 1000.0])
def test_a_file_is_as_old_as_the_time_since_it_was_modified(tmp_path, seconds):
    """A file that is modified now gets a time that is far off, as if the clock had been set."""
    path, probes = tmp_path / "alive", FileProbes()
    path.touch()
    probe, key = Probe("file", str(path), interval=0.2), ("arm", "live", 0)
    assert probes.ask(key, probe, 0, False, "").ok
    now = path.stat().st_mtime
    os.utime(path, (now + seconds, now + seconds))
    assert probes.ask(key, probe, 0, False, "").ok
    wait_for(lambda: not probes.ask(key, probe, 0, False, "").ok, 5, "the file to be too old")
