"""Which requests are accepted, how long they live, and which run a requested restart ends (rorg/core/requests.py)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from rorg.core.memory import Attempt, Due, Lease, Memory, Progress
from rorg.core.observed import Container, Observed
from rorg.core.requests import Problem, ProblemCode, mistakes, note_restarts, problems, settle, tried_again
from rorg.model.catalog import DEVELOPER, Catalog, Group, Request, Service
from rorg.model.policy import Budget, Policy

SERVICES = {
    DEVELOPER: Service(DEVELOPER, meta=True),
    "mission": Service("mission", spec={}),
    "bridge": Service("bridge", spec={}, may_act_for=("*",)),
    "camera": Service("camera", spec={}, needs=("driver",)),
    "driver": Service("driver", spec={}),
    "lidar": Service("lidar", spec={}),
}
CATALOG = Catalog(services=SERVICES, groups={"eyes": Group("eyes", ("camera", "lidar"))})
NOW = 100.0
STARTED, LATER = "2026-01-01T12:00:00Z", "2026-01-01T13:00:00Z"
RUN = f"mission@{STARTED}"
LOOK = Request("look", DEVELOPER, ("camera",))
GO = Request("go", "mission", ("camera",), incarnation=RUN)


def mission(state: str = "running", started: str = STARTED, id: str = "mission", **more: Any) -> Container:
    return Container(id, "mission", "mission", state, started, **more)


def outcome(request: Request, *seen: Container, complete: bool = True, **more: Any) -> str:
    """`kept`, or why it is dropped."""
    found = settle(CATALOG, [request], Observed(seen, complete), now=NOW, **more)
    assert len(found.requests) + len(found.dropped) == 1
    return found.dropped[0][1] if found.dropped else "kept"


# -- requests end with their requester -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seen", "what"),
    [
        ([mission()], "kept"),
        ([mission("paused")], "kept"),
        ([mission(started=LATER, brief=True)], "kept"),
        ([mission(started=LATER)], "mission was restarted"),
        ([mission("exited", exit_code=3)], "mission ended with exit code 3"),
        ([mission("exited", exit_code=0)], "mission ended with exit code 0"),
        ([mission("created")], "mission ended"),
        ([], "mission was removed"),
    ],
)
def test_a_request_ends_with_the_run_that_made_it(seen, what):
    assert outcome(GO, *seen) == what
    assert outcome(GO, *seen, complete=False) == "kept", "nothing is known for sure"
    assert outcome(replace(GO, standing=True), *seen) == "kept"
    assert outcome(replace(GO, ttl=5.0), *seen) == what


def test_requests_of_persons_and_bridges_outlive_every_run():
    assert outcome(LOOK) == "kept"
    assert outcome(replace(LOOK, incarnation="x")) == "developer was removed"
    bridged = Request("go", "bridge", ("camera",), incarnation="x", ttl=5.0)
    assert outcome(bridged) == "kept"
    assert outcome(replace(bridged, ttl=None)) == "bridge was removed"
    assert outcome(replace(bridged, requester="gone")) == "gone was removed"


@pytest.mark.parametrize(
    ("seen", "run"),
    [
        ([mission()], RUN),
        ([mission("exited", LATER, "other"), mission()], RUN),
        ([mission(brief=True)], None),
        ([mission("exited")], None),
        ([], None),
    ],
)
def test_a_request_without_a_run_is_bound_to_the_current_one(seen, run):
    unbound = replace(GO, incarnation=None)
    found = settle(CATALOG, [unbound, LOOK], Observed(tuple(seen)))
    assert found.requests == (replace(GO, incarnation=run), LOOK)
    assert found.bound == ((GO,) if run else ())


def test_a_container_of_a_service_that_became_a_meta_service_binds_nothing():
    left = Container("a", "a", DEVELOPER, "running", STARTED)
    assert settle(CATALOG, [LOOK], Observed((left,))).bound == ()


# -- leases ----------------------------------------------------------------------------------------------------


LEASED = replace(LOOK, ttl=5.0)


def test_a_lease_begins_when_it_is_first_seen_and_is_over_at_its_end():
    found = settle(CATALOG, [LEASED], Observed(), now=NOW)
    assert [lease.until for lease in found.leases.values()] == [105.0]
    assert settle(CATALOG, [LEASED], Observed()).leases[LEASED.key].until == 5.0
    assert settle(CATALOG, [LEASED], Observed(), found.leases, now=104.9).requests == (LEASED,)
    over = settle(CATALOG, [LEASED, GO], Observed(), found.leases, now=105.0)
    assert [why for _, why in over.dropped] == ["mission was removed", "its lease of 5 s ran out"]
    assert over.leases == found.leases, "it stays over even if that cannot be written down"


@pytest.mark.parametrize(
    ("change", "renewals", "until"),
    [
        ({}, {}, 105.0),
        ({}, {("other", "look"): 1}, 105.0),
        ({}, {LEASED.key: 1}, 109.0),
        ({"renewed": "again"}, {}, 109.0),
        ({"ttl": 6.0}, {}, 110.0),
        ({"reason": "curious"}, {}, 105.0),
    ],
)
def test_a_renewal_or_another_duration_begins_the_lease_again(change, renewals, until):
    known = settle(CATALOG, [LEASED], Observed(), now=NOW).leases
    again = settle(CATALOG, [replace(LEASED, **change)], Observed(), known, renewals, now=104.0)
    assert again.leases[LEASED.key].until == until


def test_a_lease_does_not_run_out_while_its_requester_sleeps_or_nothing_is_known():
    leased = replace(GO, ttl=5.0)
    lease = {leased.key: Lease("//", 1.0)}
    for seen, complete, kept in (("paused", True, 105.0), ("running", False, 105.0), ("running", True, 101.0)):
        known = settle(CATALOG, [leased], Observed((mission(),)), now=96.0).leases
        found = settle(CATALOG, [leased], Observed((mission(seen),), complete), known, now=NOW)
        assert found.leases[leased.key].until == kept
    assert settle(CATALOG, [leased], Observed((mission(),)), lease, now=NOW).requests == (leased,)
    two = Observed((mission("paused", "2026-01-01T11:00:00Z", "other"), mission()))
    assert settle(CATALOG, [leased], two, known, now=NOW).leases[leased.key].until == 101.0, "its current run goes on"
    standing = replace(leased, standing=True)
    assert settle(CATALOG, [standing], Observed(), now=NOW).leases == {}


# -- what is accepted ------------------------------------------------------------------------------------------


def codes(found: list[Problem]) -> list[str]:
    return [problem.code.value for problem in found]


def test_a_mistaken_request_is_refused_with_everything_that_is_wrong():
    assert mistakes(CATALOG, LOOK) == mistakes(CATALOG, replace(LOOK, services=("eyes",))) == []
    assert codes(mistakes(CATALOG, Request("x", "misson", ()))) == ["unknown", "empty"]
    (found,) = mistakes(CATALOG, Request("x", DEVELOPER, ("camera", DEVELOPER)))
    assert (found.code, found.remedy) == ("unknown", "`rorg get` for the services")
    first, second = mistakes(CATALOG, Request("x", DEVELOPER, ("camra", "lidr")))
    assert (first.cause, second.cause) == ("unknown service 'camra'", "unknown service 'lidr'")
    assert "camera" in first.remedy
    assert second.remedy == ""
    assert "mission" in mistakes(CATALOG, Request("x", "misson", ("camera",)))[0].remedy
    for count, told in ((10, 0), (11, 1), (15, 5)):
        found = mistakes(CATALOG, Request("x", DEVELOPER, tuple(f"no{i}" for i in range(count))))
        assert len(found) == 10 + bool(told)
        assert (f"{told} more unknown services" == found[-1].cause) is bool(told)
    both = Request("x", DEVELOPER, ("camera", "nosuch"))
    conflicting = limited(camera={"conflicts": ("lidar",)})
    assert problems(conflicting, [replace(LOOK, services=("lidar",))], both) == mistakes(conflicting, both)
    mistaken = [c.value for c in ProblemCode if Problem(c, "", "").mistaken]
    assert mistaken == ["unknown", "empty"]


def limited(policy: Policy = Policy(), **services: dict[str, Any]) -> Catalog:
    made = {name: Service(name, spec={}, **more) for name, more in services.items()}
    return Catalog(services={**SERVICES, **made}, policy=policy)


def test_a_request_must_not_make_two_services_conflict():
    catalog = limited(walk={"conflicts": ("drive",)}, drive={}, map={"conflicts": ("mission",)})
    walk, drive = (Request(name, DEVELOPER, (name,)) for name in ("walk", "drive"))
    assert problems(catalog, [], walk) == problems(catalog, [drive], replace(drive, services=("walk",))) == []
    (found,) = problems(catalog, [walk], drive)
    assert (found.code, found.cause) == (ProblemCode.CONFLICT, "'drive' and 'walk' conflict and would both be wanted")
    assert "rorg why" in found.remedy
    assert problems(catalog, [walk, drive], LOOK) == [], "it is not the cause"
    assert codes(problems(replace(catalog, requests=(walk,)), [], drive)) == ["conflict"]
    assert codes(problems(catalog, [], Request("x", "mission", ("map",)))) == ["conflict"], "with its requester"


def test_a_request_must_not_need_more_of_a_resource_than_exists():
    catalog = limited(see={"exclusive": {"gpu": 1}}, plan={"exclusive": {"gpu": 1}, "needs": ("see",)})
    (found,) = problems(catalog, [], Request("x", DEVELOPER, ("plan",)))
    assert (found.code, found.cause) == (ProblemCode.RESOURCES, "it does not fit: plan, see use 2 of 1 gpu")
    assert "Policy" in found.remedy
    assert problems(catalog, [Request("y", DEVELOPER, ("plan",))], Request("x", DEVELOPER, ("see",))) == []
    users = limited(mission={"exclusive": {"gpu": 1}}, see={"exclusive": {"gpu": 1}})
    assert codes(problems(users, [], Request("x", "mission", ("see",)))) == ["resources"]


def test_a_request_must_fit_into_a_budget_that_refuses():
    def found(over: str, existing: list[Request], *services: str) -> list[str]:
        big = {name: {"cpu": 1.0} for name in ("one", "two")}
        catalog = limited(Policy(budget=Budget(cpu=1.5, over=over)), **big, small={})
        return codes(problems(catalog, existing, Request("x", DEVELOPER, services)))

    one, both = Request("y", DEVELOPER, ("one",)), Request("z", DEVELOPER, ("one", "two"))
    assert found("refuse", [], "one") == found("refuse", [one], "one") == []
    assert found("refuse", [one], "two") == found("refuse", [], "one", "two") == ["over-budget"]
    assert found("queue", [one], "two") == []
    catalog = limited(Policy(budget=Budget(cpu=0.5, over="refuse")), one={"cpu": 1.0})
    assert "rorg release" in problems(catalog, [], one)[0].remedy
    assert found("refuse", [both], "small") == found("refuse", [both], "two") == [], "it adds nothing"


# -- new requests and restarts forget failures -----------------------------------------------------------------


FAILED = Progress(exits=3, attempts={"start": Attempt(count=3), "create": Attempt()}, error="bad", crashes=4)
CLEAN = Progress(crashes=4)


def failing(asked: tuple[Request, ...] | None) -> Memory:
    return Memory(progress={name: FAILED for name in ("camera", "driver", "lidar")}, asked=asked)


def test_a_new_request_tries_everything_again_that_it_names_or_needs():
    known = failing((GO,))
    found = tried_again(known, CATALOG, (GO, LOOK))
    assert found.asked == (GO, LOOK)
    assert [found.of(name) for name in ("camera", "driver", "lidar")] == [CLEAN, CLEAN, FAILED]
    group = tried_again(known, CATALOG, (GO, replace(LOOK, services=("eyes",))))
    assert group.of("lidar") == CLEAN
    renamed = tried_again(failing((LOOK,)), CATALOG, (replace(LOOK, services=("lidar",)),))
    assert (renamed.of("lidar"), renamed.of("camera")) == (CLEAN, FAILED)
    for failed in (Progress(exits=1, error="bad"), Progress(attempts={"start": Attempt()}, error="bad")):
        one = Memory(progress={"camera": failed}, asked=())
        assert tried_again(one, CATALOG, (LOOK,)).of("camera") == Progress()


def test_the_same_request_again_speeds_up_no_crash_loop():
    known = failing((LOOK,))
    assert tried_again(known, CATALOG, (LOOK,)) is known
    for before, now in (((LOOK,), (replace(LOOK, reason="again"),)), (None, (LOOK,)), ((LOOK, GO), (LOOK,))):
        found = tried_again(failing(before), CATALOG, now)
        assert (found.asked, found.progress) == (now, known.progress)
    fine = Memory(progress={"camera": Progress(error="x")}, asked=())
    assert tried_again(fine, CATALOG, (LOOK,)).progress is fine.progress


ASKED, WALL = {"mission": "2026-01-01T12:30:00Z"}, "2026-01-01T12:40:00Z"
DUE = {"mission": Due(ASKED["mission"], RUN)}
CRASHING = {"mission": Progress(attempts=FAILED.attempts, error="bad"), "camera": FAILED}


def restarts(known: dict[str, Due], *seen: Container, complete: bool = True, wall: str = WALL) -> Any:
    """(what is due, what is done, the memory)"""
    memory = Memory(progress=CRASHING, restarts=known)
    found, done = note_restarts(memory, ASKED, Observed(seen, complete), wall)
    return found.restarts, done, found


def test_a_restart_ends_the_run_that_goes_on_when_it_is_due():
    due, done, memory = restarts({}, mission())
    assert (due, done) == (DUE, {})
    assert set(memory.of("mission").attempts) == {"create"}, "it starts without back-off"
    assert memory.of("camera") == FAILED
    assert restarts({}, mission(), wall="2026-01-01T12:29:00Z")[:2] == ({}, {})
    assert restarts({}, mission(), wall=ASKED["mission"])[0] == DUE
    assert restarts({})[0] == {"mission": Due(ASKED["mission"], "")}
    assert restarts({}, mission(started=LATER))[0] == {"mission": Due(ASKED["mission"], f"mission@{LATER}")}
    assert restarts({}, mission(), complete=False)[:2] == ({}, {})


@pytest.mark.parametrize(
    ("seen", "due", "done"),
    [
        ([mission()], DUE, False),
        ([mission("exited")], DUE, False),
        ([mission("exited", LATER)], DUE, False),
        ([mission(started=LATER)], {}, True),
        ([mission("paused", started="2026-01-01T11:00:00Z")], {}, True),
        ([mission(started=LATER, brief=True)], DUE, False),
        ([], DUE, False),
    ],
)
def test_a_restart_is_done_when_another_run_goes_on(seen, due, done):
    found = restarts(DUE, *seen)
    assert found[:2] == (due, ASKED if done else {})
    assert found[2].progress is CRASHING


def test_a_later_restart_ends_the_run_of_its_time():
    earlier = {"mission": Due("2026-01-01T12:10:00Z", "mission@before")}
    assert restarts(earlier, mission())[:2] == (DUE, {})
    assert restarts({}, mission(brief=True))[:2] == ({}, {})


def test_a_restart_that_was_due_stays_due_although_the_clock_was_set_back():
    assert restarts(DUE, mission(), wall="1970-01-01T00:00:00Z")[:2] == (DUE, {})
    assert restarts(DUE, mission(started="1970-01-01T00:00:00Z"), wall="1970-01-01T00:00:01Z")[:2] == ({}, ASKED)


def test_while_no_restart_changes_the_memory_stays_the_same():
    memory = Memory(restarts=DUE)
    assert note_restarts(memory, ASKED, Observed((mission(),)), WALL)[0] is memory
    assert note_restarts(memory, {}, Observed((mission(),)), WALL)[0].restarts == {}
