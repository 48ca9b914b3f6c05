"""The last look at a plan before anything happens: each action that breaks a rule is found, and a sound plan passes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robots import VirtualRobot

from rorg.core.check import check
from rorg.core.links import Remote
from rorg.core.memory import InFlight
from rorg.core.observed import LABEL_JOINED
from rorg.core.operations import Create, CreateObject, Operation, Remove, RemoveObject, Start, Stop
from rorg.core.peers import Peers
from rorg.core.plan import Action, Part, ServicePlan
from rorg.core.situation import Situation

MAP = Create(name="camera", spec={}, labels={}, digest="")
ORDER = ("base", "camera", "viewer", "spare")
NET = CreateObject(object="network", name="lab", spec={}, labels={}, digest="")


@pytest.fixture
def robot(tmp_path):
    """`base` and `camera` are ready and wanted; `spare` and `viewer` are idle and need `camera`."""
    found = VirtualRobot(tmp_path)
    found.declare(
        {
            "base": {"always_on": True, "container": {"networks": ["lab"], "volumes": ["maps:/maps"]}},
            "camera": {"always_on": True, "needs": ["base"]},
            "spare": {"needs": ["camera"]},
            "cloud": {"container": {"networks": ["given"]}},
            "crew": {"type": "meta"},
            "guide": {"needs": ["crew", "camera"]},
            "viewer": {"container": {"pid": "service:camera"}, "needs": ["camera"]},
        },
        networks={"lab": {}, "given": {"external": True}},
        volumes={"maps": {}},
    )
    found.wait(lambda: found.sim.decision.memory.of("camera").ready and len(found.containers()) == 5)
    return found


def checked(robot, *actions: Action, **changes: object) -> list[str]:
    """What is wrong with these actions, in the situation of the robot with some fields changed."""
    planned = robot.sim.decision.cache.planned
    plans = {name: ServicePlan() for name in planned.plans}
    for action in actions:
        plan = plans.get(action.service, ServicePlan())
        plans[action.service] = replace(plan, actions=(*plan.actions, action))
    situation: Situation = replace(planned.situation, **changes)
    places = {name: place for place, name in enumerate([*(n for n in plans if n not in ORDER), *ORDER])}
    return check(replace(planned, situation=situation, plans=plans, places=places, replanned=tuple(plans)))


def on(robot, service: str, operation: type[Operation], **more: object) -> Action:
    """An action on the container of a service."""
    others = {"signal": "SIGTERM", "grace": 1.0, "incarnation": ""} if operation is Stop else {}
    return Action(0, operation(container=robot.container(service).id, **others), service, **more)


def known(robot) -> Situation:
    return robot.sim.decision.situation


def memory_with(robot, service: str, **changes: object):
    memory = known(robot).memory
    return replace(memory, progress={**memory.progress, service: replace(memory.of(service), **changes)})


def test_a_sound_plan_passes(robot):
    wanted = {**known(robot).wanted, "spare": ()}
    assert checked(robot, on(robot, "spare", Start), wanted=wanted) == []
    assert checked(robot, on(robot, "spare", Remove)) == []
    assert checked(robot, on(robot, "base", Stop, part_of=Part.RESTART)) == []
    assert checked(robot, on(robot, "base", Stop, surplus=True)) == []
    assert checked(robot, on(robot, "base", Stop), unplugged={"base": "its device is missing"}) == []


def test_nothing_happens_on_what_is_not_known_completely(robot):
    observed = replace(known(robot).observed, complete=False)
    assert "actions for spare on an incomplete observation" in checked(
        robot, on(robot, "spare", Remove), observed=observed
    )
    assert checked(robot, observed=observed) == []


def test_one_call_on_a_service_at_a_time(robot):
    remove = on(robot, "spare", Remove)
    memory = replace(known(robot).memory, in_flight={"spare": InFlight(remove, 0.0)})
    assert checked(robot, remove, memory=memory) == ["a second action for spare while one is under way"]
    assert checked(robot, memory=memory) == []
    assert checked(robot, remove, remove) == ["two simultaneous actions for spare"]
    assert checked(robot, remove, replace(on(robot, "spare", Remove), index=1, after=("spare",))) == []


@pytest.mark.parametrize("after", ["base", "spare"])
def test_what_is_followed_comes_before_and_does_something(robot, after):
    """`base` does nothing in this plan; and the first action of a chain cannot follow its own chain."""
    remove = on(robot, "spare", Remove, after=(after,))
    assert checked(robot, remove) == [f"{remove} comes before what it must follow"]


def test_an_action_follows_only_what_is_earlier_in_order(robot):
    first = on(robot, "base", Stop, surplus=True)
    assert checked(robot, first, on(robot, "spare", Remove, after=("base",))) == []
    late = on(robot, "base", Stop, surplus=True, after=("spare",))
    assert checked(robot, on(robot, "spare", Remove), late) == [f"{late} comes before what it must follow"]


def test_containers_of_others_are_left_alone(robot):
    theirs = Action(0, Remove(container=robot.container("base").id), "spare")
    assert f"{theirs} touches a container of base" in checked(robot, theirs)
    strange = Action(0, Remove(container="f" * 64), "spare")
    assert f"{strange} touches a container that is not ours" in checked(robot, strange)


def test_an_action_fits_the_state_of_its_container(robot):
    start = on(robot, "base", Start)
    assert checked(robot, start) == [f"{start} of a container that is running"]
    following = [on(robot, "base", Stop, part_of=Part.RESTART), replace(start, index=1, after=("base",))]
    assert checked(robot, *following) == []


def test_a_second_container_never_begins_beside_an_active_one(robot):
    """Except on an engine that keeps several of a service for the time of a change."""
    one = robot.container("spare")
    beside = replace(one, id="e" * 64, state="running")
    observed = replace(known(robot).observed, containers=(*known(robot).observed.containers, beside))
    wanted, start = {**known(robot).wanted, "spare": ()}, on(robot, "spare", Start)
    assert checked(robot, start, observed=observed, wanted=wanted) == [f"{start} beside another active container of it"]
    rolling = known(robot).engine._replace(rolls=True)
    assert checked(robot, start, observed=observed, wanted=wanted, engine=rolling) == []


def test_an_interlock_is_respected(robot):
    stop = on(robot, "base", Stop, surplus=True)
    assert checked(robot, stop, interlocks={"base": "the arm moves"}) == [f"{stop} against its interlock"]
    assert checked(robot, stop, interlocks={"base": ""}) == []
    create = Action(0, MAP, "spare")
    assert checked(robot, create, interlocks={"spare": "the arm moves"}) == [], "nothing moves by it"


def test_only_what_is_wanted_begins_and_only_what_is_unwanted_ends(robot):
    start, stop = on(robot, "spare", Start), on(robot, "base", Stop)
    assert checked(robot, start) == [f"{start}, which nothing wants"]
    assert checked(robot, stop) == [f"{stop}, which is wanted"]


def test_needs_are_ready_first(robot):
    start, wanted = on(robot, "spare", Start), {**known(robot).wanted, "spare": ()}
    memory = memory_with(robot, "camera", ready=False)
    assert checked(robot, start, wanted=wanted, memory=memory) == [f"{start} before camera is ready"]
    stop, later = on(robot, "camera", Stop, part_of=Part.RESTART), replace(start, after=("camera",))
    assert checked(robot, stop, later, wanted=wanted, memory=memory) == []


def test_a_meta_service_is_never_waited_for(robot):
    start, wanted = on(robot, "guide", Start), {**known(robot).wanted, "guide": ()}
    assert checked(robot, start, wanted=wanted) == []
    assert checked(robot, start, wanted=wanted, memory=memory_with(robot, "camera", ready=False)) == [
        f"{start} before camera is ready"
    ]


def test_a_need_on_another_machine_is_ready_as_that_one_says(robot):
    start, desired = on(robot, "spare", Start), known(robot).desired
    camera = replace(desired.catalog.services["camera"], away="base", machine="base")
    catalog = replace(desired.catalog, services={**desired.catalog.services, "camera": camera})
    there = Remote("running", True, True, "Healthy", "Synced", "x@1")
    for remote, violations in ((there, []), (replace(there, ready=False), [f"{start} before camera is ready"])):
        peers = Peers("head", remotes={"camera": remote})
        case = {"desired": replace(desired, catalog=catalog), "wanted": {**known(robot).wanted, "spare": ()}}
        not_here = memory_with(robot, "camera", ready=False)
        assert checked(robot, start, peers=peers, memory=not_here, **case) == violations


def test_nothing_is_done_to_what_has_no_container_here(robot):
    action = Action(0, Start(container="x"), "crew")
    assert f"{action}, which no manifest declares" in checked(robot, action, wanted={"crew": ()})


def test_what_no_manifest_declares_only_ends(robot):
    catalog = known(robot).desired.catalog
    services = {name: service for name, service in catalog.services.items() if name != "base"}
    desired = replace(known(robot).desired, catalog=replace(catalog, services=services))
    stop, start = on(robot, "base", Stop), on(robot, "base", Start)
    assert checked(robot, stop, desired=desired) == []
    assert checked(robot, stop, desired=desired, removals=False) == [f"{stop}, which no manifest declares"]
    assert checked(robot, stop, desired=desired, removals=False, confirmed=("base",)) == []
    assert f"{start}, which no manifest declares" in checked(robot, start, desired=desired)


def test_a_container_joins_only_one_that_exists(robot):
    create = Action(0, MAP, "viewer")
    joined = replace(MAP, labels={LABEL_JOINED: robot.container("viewer").joined})
    assert checked(robot, create) == [f"{create}, joined to no container of camera"]
    assert checked(robot, Action(0, joined, "viewer")) == []
    assert checked(robot, Action(0, MAP, "spare")) == []


def test_networks_and_volumes_of_others_are_left_alone(robot):
    make, given = Action(0, NET, "network/lab"), Action(0, replace(NET, name="given"), "network/given")
    objects = known(robot).observed.objects
    assert checked(robot, make) == [f"{make}, which is not for rorg to make"], "it exists"
    assert checked(robot, given) == [f"{given}, which is not for rorg to make"]
    undeclared = Action(0, replace(NET, name="gone"), "network/gone")
    assert checked(robot, undeclared) == [f"{undeclared}, which is not for rorg to make"]
    remove = Action(0, RemoveObject(object="network", name="lab"), "network/lab")
    again = replace(make, index=1, after=("network/lab",))
    assert checked(robot, remove) == []
    assert checked(robot, remove, again) == [], "it is made in another form"
    theirs = replace(objects.found["network/lab"], owner="another robot")
    for found in ({}, {"network/lab": theirs}):
        observed = replace(known(robot).observed, objects=replace(objects, found=found))
        assert checked(robot, remove, observed=observed) == [f"{remove} touches what is not ours"]
    assert checked(robot, make, observed=replace(known(robot).observed, objects=replace(objects, found={}))) == []


def test_networks_and_volumes_are_known_before_anything_happens_to_them(robot):
    make, start = Action(0, NET, "network/lab"), Action(0, Start(container="x"), "network/lab")
    unknown = replace(known(robot).observed, objects=None)
    assert checked(robot, make, observed=unknown) == ["actions for network/lab on an incomplete observation"]
    assert checked(robot, start) == [f"{start} on a container of what has none"]


def test_a_volume_goes_only_by_a_purge_once_it_is_undeclared(robot):
    remove, desired = Action(0, RemoveObject(object="volume", name="maps"), "volume/maps"), known(robot).desired
    undeclared = replace(desired, objects={key: one for key, one in desired.objects.items() if key != "volume/maps"})
    assert checked(robot, remove, purge=True) == [f"{remove} loses data"]
    assert checked(robot, remove, desired=undeclared) == [f"{remove} loses data"]
    assert checked(robot, remove, desired=undeclared, purge=True) == []
    assert checked(robot, remove, desired=undeclared, purge=True, removals=False) == [
        f"{remove}, which no manifest declares"
    ]
