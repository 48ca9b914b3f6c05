"""What rorg remembers of a service and its changes, value by value (rorg/core/memory.py, update.py, changes.py)."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import pytest

from rorg.core.desired import desire
from rorg.core.devices import given, nodes_of, replugged, unplugged
from rorg.core.digest import Rules, labels
from rorg.core.memory import Attempt, CountedOn, Memory, Progress
from rorg.core.observed import LABEL_RULES, Container, Observed
from rorg.core.operations import OPERATIONS, Create, Start
from rorg.core.plan import Timed, prefixed, printed
from rorg.core.shared_memory import none_runs
from rorg.core.situation import Exclusive, Situation, View
from rorg.core.update import Update
from rorg.core.wanted import Cause
from rorg.model.catalog import Catalog, Service
from rorg.model.devices import Device, Plugged
from rorg.model.policy import Policy
from rorg.model.units import format_left

STARTED = "2026-01-01T12:00:00Z"


def box(service: str = "base", state: str = "running", **more: str) -> Container:
    return Container(service, service, service, state, STARTED, **more)


# -- runs ------------------------------------------------------------------------------------------------------


def test_of_each_container_the_last_stopped_run_is_remembered():
    known = Progress(stopped=("a@1", "b@1"))
    assert known.with_stopped("b@1") is known
    assert known.with_stopped("a@2").stopped == ("b@1", "a@2")
    many = Progress(stopped=tuple(f"c{n}@1" for n in range(16))).with_stopped("d@1")
    assert many.stopped == (*(f"c{n}@1" for n in range(1, 16)), "d@1")


def test_a_container_that_the_engine_cannot_start_is_spent():
    known = Progress(attempts={"start": Attempt(("base",), spent=True)})
    assert known.spent(box())
    assert not known.spent(box("other"))
    assert not Progress(attempts={"start": Attempt(("base",))}).spent(box())
    assert not Progress().spent(box())
    assert not Progress(attempts={"create": Attempt(("base",), spent=True)}).spent(box())


@pytest.mark.parametrize(
    ("restart", "state", "code", "exited", "over"),
    [
        ("never", "exited", 1, True, True),
        ("never", "exited", 1, False, False),
        ("never", "created", 1, True, False),
        ("on-failure", "exited", 0, True, True),
        ("on-failure", "exited", 1, True, False),
        ("always", "exited", 0, True, False),
    ],
)
def test_a_run_is_over_if_its_policy_does_not_restart_it(restart, state, code, exited, over):
    ended = replace(box(state=state), exit_code=code)
    known = Progress(exited=ended.incarnation if exited else "")
    assert known.over(Service("base", restart=restart), ended) is over


def test_attempts_are_kept_by_operation():
    known = Progress().attempting(Create, Attempt(missing=True, at=5.0)).start_after(7.0, "busy")
    assert known.attempts == {"create": Attempt(missing=True, at=5.0), "start": Attempt(at=7.0, error="busy")}
    assert (known.retry_at, known.missing, known.error) == (7.0, True, "busy")
    assert (known.attempt(Start), known.start_forgotten().attempt(Start)) == (Attempt(at=7.0, error="busy"), None)
    assert (Progress().retry_at, Progress().missing, known.start_forgotten().missing) == (0.0, False, True)
    assert Memory().of("base") == Progress()


@pytest.mark.parametrize(
    ("counted", "now", "lost"),
    [
        (CountedOn(f"base@{STARTED}", {"core": "earlier"}), box("core"), True),
        (CountedOn(f"base@{STARTED}", {"core": f"core@{STARTED}"}), box("core"), False),
        (CountedOn(f"base@{STARTED}", {"core": "earlier"}), replace(box("core"), brief=True), False),
        (CountedOn(f"base@{STARTED}"), box("core"), False),
        (CountedOn("base@later", {"core": "earlier"}), box("core"), False),
    ],
)
def test_a_run_has_lost_a_need_of_which_another_run_goes_on(counted, now, lost):
    assert counted.lost("core", box(), now) is lost


def test_the_current_container_is_the_one_that_is_alive_or_began_last():
    first, second, third = box(state="exited"), replace(box(), id="b"), replace(box(state="exited"), id="c")
    later = replace(third, started_at="2026-01-02")
    assert Observed((first, second, later)).current("base") is second
    assert Observed((first, later)).current("base") is later
    assert Observed((first, third)).current("base") is third, "of equals always the same one"
    assert Observed((replace(first, service=""),)).by_service() == {}
    there = Observed(elsewhere={"base": first})
    assert (there.current("base"), there.by_service(), there.current("arm")) == (first, {}, None)


# -- changes ---------------------------------------------------------------------------------------------------


def test_failed_editions_are_remembered_up_to_a_number():
    update = Update(edition="now")
    for n in range(16):
        update = replace(update, edition=f"e{n}").quarantine("bad", 0.0)
    assert update.failed == "bad"
    assert list(replace(update, edition="now").quarantine("late", 0.0).quarantined) == [
        *(f"e{n}" for n in range(1, 16)),
        "now",
    ]
    assert list(replace(update, edition="e3").quarantine("late", 0.0).quarantined)[-1] == "e3"
    assert replace(update, edition="new").failed == ""
    assert replace(update, edition="new", drawn="arm failed").failed == "arm failed"


def test_a_run_has_read_what_was_there_when_it_began():
    run, present = f"base@{STARTED}", {"map": "2", "log": "1"}
    assert Update().noting(box(), present) == Update(run=run, content=present, present=present)
    mixed = {"map": "1", "log": "1"}
    assert Update(begun={"map": "1"}).noting(box(), present) == Update(run=run, content=mixed, present=present)
    by_hand = Update(present={"map": "1"}).noting(box(), present)
    assert (by_hand.content, by_hand.present) == (mixed, present), "perhaps before the change"
    begun = Update(begun={"map": "1"}, present=present)
    for none_of_rorgs in (None, box(state="exited"), replace(box(), brief=True)):
        assert begun.noting(none_of_rorgs, present) is begun
    known = Update(run=run, content={"map": "1"}, present={"map": "2"})
    assert known.noting(box(), {"map": "2"}) is known
    assert known.noting(box(), present).content == mixed
    assert known.changed_content(box(), present) == ("map",)
    assert known.changed_content(box(), {"map": "1"}) == ()
    assert known.changed_content(replace(box(), started_at="later"), present) == ()


# -- devices ---------------------------------------------------------------------------------------------------


LASER = Device("/dev/laser:/dev/l", "/dev/laser")
ARM = Device("udev(serial=7):/dev/arm:rw", udev=(("serial", "7"),))
DRIVER = Service("base", spec={"image": "x"}, devices=(LASER, ARM))
PLUGGED = {LASER: Plugged("/dev/ttyUSB0", "c 188:0"), ARM: Plugged("/dev/ttyUSB1", "c 188:1")}


def test_a_driver_waits_for_each_of_its_devices():
    desired = desire(Catalog({"base": DRIVER}))
    assert unplugged(desired, PLUGGED) == {}
    gone = Plugged(problem="is not there")
    assert unplugged(desired, {**PLUGGED, LASER: gone}) == {"base": "/dev/laser is not there"}
    assert unplugged(desired, {LASER: gone, ARM: gone}) == {"base": "/dev/laser is not there"}, "the first one"
    looked_for = {"base": "a device with serial 7 is being looked for"}
    assert unplugged(desired, {}) == looked_for, "a path that is not known yet holds nothing back"


def test_nodes_of_devices_are_known_if_all_are_plugged_in():
    nodes = '{"/dev/laser":"c 188:0 /dev/ttyUSB0","udev(serial=7)":"c 188:1 /dev/ttyUSB1"}'
    assert nodes_of(DRIVER, PLUGGED) == nodes
    assert nodes_of(DRIVER, {LASER: PLUGGED[LASER]}) == ""
    assert nodes_of(DRIVER, {**PLUGGED, ARM: Plugged(problem="is not there")}) == ""
    assert nodes_of(Service("base"), PLUGGED) == ""
    moved = nodes.replace("ttyUSB1", "ttyUSB2")
    assert replugged(box(devices=nodes), moved)
    for before, now in ((nodes, nodes), ("", moved), (nodes, ""), (nodes, '{"/dev/other":"c 1:1"}')):
        assert not replugged(box(devices=before), now)


def test_a_device_found_by_its_attributes_gets_its_present_node():
    spec = {"image": "x", "devices": [LASER.text, ARM.text]}
    assert given(spec, DRIVER, PLUGGED)["devices"] == [LASER.text, "/dev/ttyUSB1:/dev/arm:rw"]
    assert given(spec, DRIVER, {LASER: PLUGGED[LASER]}) is spec
    assert given(spec, DRIVER, {ARM: Plugged(problem="is not there")}) is spec


def test_shared_memory_is_unused_if_no_participant_and_nothing_unknown_runs():
    services = {"nav": Service("nav"), "web": Service("web")}
    users = frozenset({"nav"})
    assert none_runs(users, services, Observed((box("web"), box("nav", "exited"))))
    for seen in (box("nav"), box("nav", "paused"), box("gone")):
        assert not none_runs(users, services, Observed((seen,)))
    assert not none_runs(users, services, Observed(complete=False))


# -- operations ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flag", "verbs"),
    [
        ("begins", "start resume activate"),
        ("ends", "deactivate pause stop remove"),
        ("idles", "deactivate pause stop"),
        ("optional", "update rename signal remove"),
        ("brings_up", "create rename start resume activate"),
        ("of_nodes", "activate deactivate"),
    ],
)
def test_what_operations_do_to_a_run(flag, verbs):
    assert [o.verb for o in OPERATIONS if getattr(o, flag)] == verbs.split()
    assert [o.verb for o in OPERATIONS if not o.felt] == ["create", "rename"]


# -- exclusive resources and countdowns ------------------------------------------------------------------------


def exclusive(wanted: str, capacity: int = 1, seen: str = "running", left: int = 0, **users: int) -> Exclusive:
    """Services that use so many units of `gpu`, all in one state, and one that is no longer declared."""
    services = {name: Service(name, spec={}, exclusive={"gpu": units}) for name, units in users.items()}
    rules = labels("robot", "gone", {}, "", Rules(exclusive={"gpu": left}))[LABEL_RULES]
    gone = box("gone", rules=rules)
    found = Situation(
        desired=desire(Catalog(services=services, policy=Policy(resources={"gpu": capacity}))),
        observed=Observed((*(box(name, seen) for name in users), *([gone] if left else []))),
        memory=Memory(),
        now=100.0,
        owner="robot",
        wanted={name: (Cause("always_on"),) for name in wanted.split()},
        urgent=frozenset(),
    )
    return Exclusive(found, {"gone": [gone]} if left else {})


@pytest.mark.parametrize(
    ("robot", "holders"),
    [
        (exclusive("a", a=1, b=1), ["b"]),
        (exclusive("a", a=1, b=1, seen="paused"), ["b"]),
        (exclusive("a", a=1, b=1, seen="exited"), []),
        (exclusive("a", 2, a=1, b=1), []),
        (exclusive("a", 2, a=1, b=1, c=1), ["b", "c"]),
        (exclusive("a b", 2, a=1, b=1, c=1), ["c"]),
        (exclusive("a b c", 2, a=1, b=1, c=1), ["b", "c"]),
        (exclusive("a", left=1, a=1), ["gone"]),
        (exclusive("a b", left=1, a=1, b=1), ["gone"]),
        (exclusive("a", 2, left=1, a=1), []),
    ],
)
def test_unwanted_holders_let_go_of_a_resource_first(robot, holders):
    assert robot.holders(robot.desired.catalog.services["a"], "gpu", lambda name: False) == holders


@pytest.mark.parametrize(
    ("robot", "contested"),
    [
        (exclusive("b", a=1, b=1), True),
        (exclusive("b", 2, a=1, b=1), False),
        (exclusive("", a=1, b=1), False),
        (exclusive("b", 2, left=1, a=1, b=1), True),
        (exclusive("b", seen="exited", a=1, b=1), True),
        (exclusive("b", 2, seen="exited", a=1, b=1), False),
    ],
)
def test_a_resource_is_contested_if_a_wanted_service_does_not_fit_beside(robot, contested):
    assert robot.contested(robot.desired.catalog.services["a"]) is contested


@pytest.mark.parametrize(
    ("now", "shown"),
    [(92.0, "in 8 s"), (92.5, "in 8 s"), (99.9999999, "in 1 s"), (100.0, "in 0 s"), (100.25, "in 0.2 s")],
)
def test_a_countdown_shows_whole_seconds_until_its_moment(now, shown):
    assert Timed("in ", 100.0).at(now) == shown
    assert printed(prefixed("again ", Timed("in ", 100.0, ": no")), now) == f"again {shown}: no"
    assert printed(prefixed("again ", "soon"), now) == "again soon"


@pytest.mark.parametrize(("now", "shown"), [(92.0, "start failed: again in 8 s"), (100.0, "start failed: now")])
def test_a_countdown_may_end_with_other_words(now, shown):
    assert printed(prefixed("start failed: ", Timed("again in ", 100.0, due="now")), now) == shown


@pytest.mark.parametrize(("left", "text"), [(-1.0, "now"), (0.0, "now"), (0.2, "in 1 s"), (7.5, "in 8 s")])
def test_no_time_left_is_now(left, text):
    assert format_left(left) == text


def test_a_plan_holds_until_the_first_moment_that_it_asks_for():
    robot = exclusive("a", a=1)
    view = View(robot.s, robot, lambda _: pytest.fail("no plan is read"), hurry=False)
    assert (view.has_come(100.0), view.has_come(99.0), view.until) == (True, True, inf)
    assert [view.has_come(moment) for moment in (101.0, 100.5, 500.0)] == [False] * 3
    assert (view.until, view.volatile) == (100.5, False)
    assert (view.now, view.volatile) == (100.0, True)
