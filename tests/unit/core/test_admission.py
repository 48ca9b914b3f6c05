"""Who is admitted when not everything that is wanted fits, rule by rule."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Collection
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rorg.core.admission import Admitted, admission_for, admit, over_budget
from rorg.core.contests import Admission
from rorg.core.priorities import effective_priorities
from rorg.core.wanted import wanted
from rorg.model.catalog import Catalog, Group, Request, Service
from rorg.model.graph import closure, conflicting
from rorg.model.policy import Budget, Policy

GPU = {"gpu": 1}
META = Service("developer", meta=True)


def tree(*services: Service, budget: Budget | None = None, **more: object) -> Catalog:
    declared = {service.name: service for service in (META, *services)}
    return Catalog(services=declared, policy=Policy(budget=budget), **more)


def ask(*services: str, by: str = "developer", priority: int | None = None, id: str = "") -> Request:
    return Request(id or "+".join(services), by, services, priority=priority)


def admitted(catalog: Catalog, *requests: Request, **excluded: str) -> Admission:
    return admit(catalog, requests, excluded)


def names(admission: Admission) -> set[str]:
    return set(admission.wanted) - {"developer"}


# -- contests --------------------------------------------------------------------------------------------------


def test_priority_decides_a_contest_and_then_the_name():
    catalog = tree(Service("a", exclusive=GPU, priority=1), Service("b", exclusive=GPU), Service("c", exclusive=GPU))
    found = admitted(catalog, ask("a"), ask("b"), ask("c"))
    assert names(found) == {"b"}
    assert found.preempted == dict.fromkeys("ac", "waits for gpu, which is taken by b")


def test_a_loser_runs_though_two_that_need_it_lose_to_others():
    """`base` lost to `camera`, which loses to `tracker`. With `base`, `dock` and `push` come back, and lose."""
    catalog = tree(
        Service("base", exclusive={"can0": 1}, priority=10),
        Service("camera", exclusive={"can0": 1, "gpu": 1}),
        Service("tracker", exclusive=GPU, priority=90),
        Service("dock", needs=("base",), exclusive={"left": 1}, priority=1),
        Service("push", needs=("base",), exclusive={"right": 1}, priority=1),
        Service("arm", exclusive={"left": 1}),
        Service("lift", exclusive={"right": 1}),
    )
    found = admitted(catalog, *map(ask, ("base", "camera", "tracker", "dock", "push", "arm", "lift")))
    assert names(found) == {"base", "tracker", "arm", "lift"}
    assert found.preempted == {
        "camera": "waits for gpu, which is taken by tracker",
        "dock": "waits for left, which is taken by arm",
        "push": "waits for right, which is taken by lift",
    }
    assert found.priorities == effective_priorities(catalog, found.wanted, found.requests)


def test_what_comes_back_wins_over_what_matters_less_and_took_its_place():
    """`dock` needs `base`, which lost to `camera`; `lamp` took what `dock` uses. Then `camera` itself loses."""
    catalog = tree(
        Service("base", exclusive={"can0": 1}),
        Service("camera", exclusive={"can0": 1, "gpu": 1}, priority=90),
        Service("tracker", exclusive=GPU, priority=95),
        Service("dock", needs=("base",), exclusive={"light": 1}, priority=80),
        Service("lamp", exclusive={"light": 1}, priority=10),
    )
    found = admitted(catalog, *map(ask, ("base", "camera", "tracker", "dock", "lamp")))
    assert names(found) == {"base", "dock", "tracker"}
    assert found.preempted == {
        "camera": "waits for gpu, which is taken by tracker",
        "lamp": "waits for light, which is taken by dock",
    }


def test_what_two_losers_request_gives_way_to_the_one_that_is_left():
    """Each of the two asks for `map`, which would win over both; without both, nobody would want it."""
    catalog = tree(
        Service("left", exclusive=GPU, priority=20),
        Service("right", exclusive=GPU, priority=10),
        Service("map", exclusive=GPU, priority=90),
    )
    found = admitted(catalog, ask("left"), ask("right"), ask("map", by="left"), ask("map", by="right"))
    assert names(found) == {"left"}
    assert found.preempted == {
        "map": "waits for gpu, which is taken by left, for which it was requested",
        "right": "waits for gpu, which is taken by left",
    }


def test_units_of_a_resource_are_counted():
    catalog = replace(
        tree(Service("a", exclusive={"lane": 2}, priority=60), Service("b", exclusive={"lane": 1})),
        policy=Policy(resources={"lane": 3}),
    )
    assert names(admitted(catalog, ask("a"), ask("b"))) == {"a", "b"}
    catalog = replace(catalog, policy=Policy(resources={"lane": 1}))
    found = admitted(catalog, ask("a"), ask("b"))
    assert names(found) == {"b"}
    assert found.preempted == {"a": "waits for lane, which has fewer units than it uses"}


# -- holds -----------------------------------------------------------------------------------------------------


def test_what_is_held_takes_what_needs_it_along():
    catalog = tree(Service("a"), Service("b", needs=("a",)), Service("c", needs=("b",)), Service("d"))
    found = admitted(catalog, ask("c"), ask("d"), a="held")
    assert names(found) == {"d"}
    assert found.preempted == {"a": "held", "b": "a held", "c": "a held"}


def test_a_meta_service_is_never_preempted():
    catalog = tree(Service("a"), Service("b", needs=("a",)), Service("tour", meta=True, needs=("b",)))
    found = admitted(catalog, ask("b"), a="held", developer="held", tour="held")
    assert set(found.wanted) == {"developer", "tour"}
    assert found.preempted == {"a": "held", "b": "a held"}
    assert names(admitted(catalog, ask("b"), gone="held")) == {"a", "b", "tour"}, "a hold of what is declared no more"


# -- effective priorities --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("own", "asked", "found"), [(0, 0, 0), (0, None, 0), (50, 20, 50), (50, 80, 80)])
def test_a_request_raises_the_priority_of_what_it_names(own, asked, found):
    catalog = tree(Service("a", priority=own, needs=("b",)), Service("b", priority=1))
    requests = (ask("a", priority=asked),)
    priorities = effective_priorities(catalog, wanted(catalog, requests), requests)
    assert priorities == {"developer": 0, "a": found, "b": max(found, 1)}


def test_a_priority_counts_for_the_request_that_has_it():
    catalog = tree(Service("a"), Service("b"), Service("c"), groups={"both": Group("both", ("a", "b"))})
    requests = ask("both", priority=70), ask("c")
    found = effective_priorities(catalog, wanted(catalog, requests), requests)
    assert found == {"developer": 0, "a": 70, "b": 70, "c": 50}


def test_what_a_protected_service_needs_is_above_every_priority():
    catalog = tree(Service("stop", protected=True, always_on=True, needs=("bus",)), Service("bus"), Service("a"))
    requests = (ask("a", priority=100),)
    found = effective_priorities(catalog, wanted(catalog, requests), requests)
    assert found["stop"] == found["bus"] > found["a"] == 100


def test_priorities_go_through_a_ring_of_requests():
    catalog = tree(Service("a", priority=10), Service("b", priority=20), Service("c", priority=30))
    requests = ask("a"), ask("b", by="a"), ask("c", by="b"), ask("a", by="c")
    found = effective_priorities(catalog, wanted(catalog, requests), requests)
    assert found == {"developer": 0, "a": 30, "b": 30, "c": 30}


# -- the budget ------------------------------------------------------------------------------------------------

QUEUE = Budget(cpu=1.0, memory=1 << 30, over="queue")


def test_the_budget_is_exceeded_above_it_not_at_it():
    catalog = tree(
        Service("a", cpu=0.5, memory=1 << 29), Service("b", cpu=0.5, memory=1 << 29), Service("c", memory=1 << 30)
    )
    catalog = replace(catalog, policy=Policy(budget=QUEUE))
    assert over_budget(catalog, ["a", "b", "gone"]) == ""
    assert over_budget(catalog, "abc") == "2.0Gi would exceed the budget of 1.0Gi"
    assert over_budget(tree(Service("a", cpu=1.0 + 1e-9), budget=QUEUE), "a") == "", "a sum of floats"
    assert over_budget(tree(Service("a", cpu=1.5), budget=QUEUE), "a") == "1.5 cores would exceed the budget of 1"
    assert over_budget(tree(Service("a", cpu=9.0), budget=Budget()), "a") == ""
    assert over_budget(tree(Service("a", cpu=9.0)), "a") == ""


def test_requests_that_do_not_fit_wait_by_priority():
    catalog = tree(Service("a", cpu=0.8), Service("b", cpu=0.8), Service("c", cpu=0.8, priority=60), budget=QUEUE)
    found = admitted(catalog, ask("a"), ask("b"), ask("c"))
    assert names(found) == {"c"}
    assert found.preempted == dict.fromkeys("ab", "waits for room: 1.6 cores would exceed the budget of 1")
    assert names(admitted(catalog, ask("a"), ask("b", priority=70), ask("c"))) == {"b"}
    assert names(admitted(catalog, ask("b"), ask("a"))) == {"b"}, "of equal ones the older one"


@pytest.mark.parametrize("over", ["admit", "refuse"])
def test_only_a_policy_that_says_so_lets_requests_queue(over):
    catalog = tree(Service("a", cpu=0.8), Service("b", cpu=0.8), budget=replace(QUEUE, over=over))
    assert names(admitted(catalog, ask("a"), ask("b"))) == {"a", "b"}


def test_a_request_that_takes_no_room_is_admitted_though_the_budget_is_exceeded():
    catalog = tree(Service("a", cpu=2.0, always_on=True), Service("b"), Service("c", cpu=0.1), budget=QUEUE)
    found = admitted(catalog, ask("b"), ask("c"))
    assert names(found) == {"a", "b"}
    assert set(found.preempted) == {"c"}


def test_what_conflicts_in_the_queue_takes_no_room():
    """`b` gives way to `a`, so that its 0.8 cores are free for `c`."""
    services = Service("a", conflicts=("b",), priority=90), Service("b", cpu=0.8, priority=80), Service("c", cpu=0.8)
    found = admitted(tree(*services, Service("d", cpu=0.5), budget=QUEUE), *map(ask, "abcd"))
    assert names(found) == {"a", "c"}
    assert found.preempted["b"] == "conflicts with a, which has priority"
    assert found.preempted["d"].startswith("waits for room")


def test_the_contest_is_the_reason_of_what_loses_it_and_has_no_room():
    """`arm` does not fit when its request is looked at; later `camera` takes its gripper as well."""
    catalog = tree(
        Service("arm", exclusive={"gripper": 1}, cpu=1.5, priority=80),
        Service("camera", exclusive={"gripper": 1}, cpu=0.5),
        Service("tour"),
        budget=QUEUE,
    )
    found = admitted(catalog, ask("arm", priority=99), ask("camera", priority=90), ask("arm", by="tour"), ask("tour"))
    assert names(found) == {"camera", "tour"}
    assert found.preempted == {"arm": "waits for gripper, which is taken by camera"}


def test_a_request_of_an_inactive_requester_takes_no_room():
    catalog = tree(Service("a", cpu=0.8), Service("b", cpu=0.8), Service("tour"), budget=QUEUE)
    found = admitted(catalog, ask("a", by="tour", priority=100), ask("b"))
    assert names(found) == {"b"}
    assert found.preempted == {}


# -- reuse -----------------------------------------------------------------------------------------------------


def test_an_admission_is_reused_while_what_it_depends_on_is_the_same():
    catalog, requests = tree(Service("a")), (ask("a"),)
    first = admission_for(Admitted(), catalog, requests, {})
    assert admission_for(first, catalog, (ask("a"),), {}) is first
    assert names(admission_for(first, catalog, (), {}).admission) == set()
    assert names(admission_for(first, catalog, requests, {"a": "held"}).admission) == set()
    other = tree(Service("a"), Service("b", always_on=True))
    assert names(admission_for(first, other, requests, {}).admission) == {"a", "b"}


# -- any tree --------------------------------------------------------------------------------------------------


UNITS = {"z": 2}
"""Of each other resource of these trees there is one unit."""


def excluded_among(services: dict[str, Service], names: Collection[str]) -> bool:
    """Whether these services can never all run."""
    used = Counter[str]()
    for name in names:
        used.update(services[name].exclusive)
    return bool(conflicting(services, names)) or any(n > UNITS.get(resource, 1) for resource, n in used.items())


@st.composite
def contests(draw):
    """A tree of services that need, conflict with and exclude each other, though none what it needs; and requests."""
    found: dict[str, Service] = {}
    for index in range(draw(st.integers(3, 7))):
        earlier = st.lists(st.sampled_from(sorted(found)), max_size=2, unique=True) if found else st.just([])
        resources = Counter(draw(st.lists(st.sampled_from("aabzzz"), max_size=2)))
        one = Service(
            f"s{index}",
            conflicts=tuple(draw(earlier)),
            exclusive={resource: min(n, UNITS.get(resource, 1)) for resource, n in resources.items()},
            priority=draw(st.integers(0, 3)),
            always_on=draw(st.integers(0, 9)) == 0,
        )
        with_needs = replace(one, needs=tuple(draw(earlier)))
        possible = not excluded_among({**found, one.name: one}, {one.name, *closure(found, with_needs.needs)})
        found[one.name] = with_needs if possible else one
    names = sorted(found)
    unasked = draw(st.lists(st.sampled_from(names), max_size=2, unique=True))
    requests = [ask(name) for name in names if name not in unasked]
    pairs = draw(st.lists(st.tuples(st.sampled_from(names), st.sampled_from(names)), max_size=2, unique=True))
    return forest(*found.values()), (*requests, *(ask(to, by=by, id=f"{by}>{to}") for by, to in pairs))


def forest(*services: Service) -> Catalog:
    return replace(tree(*services), policy=Policy(resources=UNITS))


def shown(catalog: Catalog, requests: tuple[Request, ...]) -> str:
    """A case of test_who_is_left_of_several_contests."""
    lines = [
        " ".join(
            [
                s.name,
                f"{s.priority}",
                "".join(resource * n for resource, n in s.exclusive.items()),
                *(f">{n}" for n in s.needs),
                *(f"!{n}" for n in s.conflicts),
                *("*" for _ in "*" if s.always_on),
            ]
        )
        for s in catalog.services.values()
    ]
    return repr(("\n".join(lines[1:]), " ".join(r.id for r in requests)))


def told_apart(catalog: Catalog, requests: tuple[Request, ...], found: Admission) -> None:
    """What is admitted can run together. What is preempted could not run beside what matters as much, or would bring
    something along that takes the place of what runs."""
    services, running = catalog.services, set(found.wanted)
    assert not excluded_among(services, running), shown(catalog, requests)
    assert all(set(services[name].needs) <= running for name in running)
    for name, why in found.preempted.items():
        others = found.preempted.keys() - {name}
        asked = wanted(catalog, requests, others)
        if name not in asked:
            continue
        named = re.findall(r"(?:taken by|conflicts with) (s\d(?:, s\d)*)", why)
        assert {n for names in named for n in names.split(", ")} <= running, f"{name} {why} {shown(catalog, requests)}"
        ranks, below = effective_priorities(catalog, asked, requests), closure(services, [name])
        less = {n for n in running if found.priorities[n] < ranks[name]}
        alone = effective_priorities(catalog, wanted(catalog, requests, others | less), requests)
        less = {n for n in less if found.priorities[n] < alone.get(name, -1)}  # without what these ask for
        if not any(excluded_among(services, {b, *running}) for b in asked.keys() - running - below):
            case = shown(catalog, requests)
            assert excluded_among(services, running - less | below), f"{name} could run: {why} {case}"


@settings(max_examples=int(os.environ.get("RORG_TEST_EXAMPLES") or 300), deadline=None)
@given(contests())
def test_nobody_gives_way_to_nobody(case):
    told_apart(*case, admit(*case, {}))


def some(text: str) -> tuple[Service, ...]:
    """Services by name, priority, exclusive resources, >needs and !conflicts: "base 3 ac >x !y". * is always on."""
    found = []
    for line in text.splitlines():
        name, priority, *words = line.split()
        resources = Counter("".join(w for w in words if w[0] not in ">!*"))
        needs, rivals = (tuple(w[1:] for w in words if w[0] == mark) for mark in ">!")
        one = Service(name, priority=int(priority), exclusive=resources, needs=needs, conflicts=rivals)
        found.append(replace(one, always_on="*" in words))
    return tuple(found)


@pytest.mark.parametrize(
    ("services", "requests", "running"),
    [
        ("s0 0\ns1 0 a >s0\ns2 1\ns3 1 !s2 !s0\ns6 0 a", "s0 s1 s2 s3 s6", "s0 s1 s2"),
        ("s0 0\ns1 0 ab >s0\ns2 1 ab !s0\ns3 2 b\ns4 0 a >s0", "s0 s1 s2 s3 s4", "s0 s3 s4"),
        ("s0 0 c\ns1 0 !s0\ns2 0 !s0\ns3 1 c", "s0 s2 s3 s2>s1", "s1 s2 s3"),
        ("s0 0\ns1 0\ns2 0 a\ns3 0 a\ns4 0 !s0\ns5 0 a >s0 !s3", "s1 s2 s3 s4 s5", "s1 s2 s4"),
        ("s0 0\ns3 0 !s0\ns4 0 a >s3\ns5 1 a", "s4 s5 s3>s0", "s5"),
        ("s0 0 a\ns1 0\ns3 1 a >s1\ns4 2 a !s1", "s0 s1 s2 s3 s4 s4>s0", "s4"),
        ("s0 9 a\ns1 8 ab\ns2 7 bc\ns3 6 cd\ns4 5 d", "s0 s1 s2 s3 s4", "s0 s2 s4"),
        ("s0 1\ns2 0 a\ns3 0 a\ns4 0 !s3\ns5 2 !s0", "s0 s2 s3 s4 s4>s5", "s2 s4 s5"),
        ("s0 1 a\ns1 0\ns2 2 !s0 !s1\ns3 0 >s2\ns5 1 a !s3", "s0 s1 s3 s5", "s0 s1"),
        ("s0 0\ns2 1 !s0", "s0 s0>s2 s2>s0", "s0"),
        ("s0 0 a\ns1 0 a\ns2 0 a", "s0 s1 s2", "s0"),
        ("s0 5 a\ns1 9\ns2 0 !s1", "s0 s2 s0>s1", "s0 s1"),
        ("s0 5 a\ns1 9 b !s0", "s0 s0>s1", "s0"),
        ("s0 5 a\ns1 9 ab", "s0 s0>s1", "s0"),
        ("s3 1 z\ns4 0 z\ns5 1 z >s4", "s3 s4 s5", "s3 s4"),
        ("s0 0 *\ns1 1\ns2 0 !s0 *", "s0>s1 s1>s2", "s0 s1"),
        ("s0 0\ns1 0 a\ns2 0 a\ns3 0 a\ns4 0 >s3 !s2", "s0 s1 s2 s3 s4", "s0 s1"),
    ],
)
def test_who_is_left_of_several_contests(services, requests, running):
    """Found by random trees, and made as small as they go. `a>b` is a request of a for b."""
    catalog, asked = forest(*some(services)), []
    for text in requests.split():
        by, _, name = text.rpartition(">")
        asked += [ask(name, by=by or "developer", id=text)] if name in catalog.services else []
    found = admitted(catalog, *asked)
    assert names(found) == set(running.split())
    told_apart(catalog, tuple(asked), found)


def test_a_meta_service_takes_part_in_no_contest():
    crew = Service("crew", meta=True, exclusive=GPU, conflicts=("arm",), priority=100)
    found = admitted(tree(crew, Service("arm"), Service("camera", exclusive=GPU)), ask("arm"), ask("camera"))
    assert set(found.wanted) == {"developer", "crew", "arm", "camera"}


def test_what_was_turned_round_says_what_for():
    catalog = tree(Service("arm", exclusive={"cam": 1, "gpu": 1}), Service("look", exclusive=GPU, priority=90))
    found = admitted(catalog, ask("arm"), ask("look", by="arm"))
    assert found.preempted == {"look": "waits for gpu, which is taken by arm, for which it was requested"}
    catalog = tree(Service("arm", exclusive={"cam": 1}, conflicts=("look",)), Service("look", priority=90))
    found = admitted(catalog, ask("arm"), ask("look", by="arm"))
    assert found.preempted == {"look": "conflicts with arm, for which it was requested"}


def test_what_is_held_and_not_asked_for_is_not_preempted():
    found = admitted(tree(Service("a"), Service("b", needs=("a",))), b="held", a="held")
    assert found.preempted == {}
    found = admitted(tree(Service("a"), Service("b", needs=("a",))), ask("b"), b="held by you", a="held")
    assert found.preempted == {"a": "held", "b": "held by you"}, "its own reason"
