"""What rorg does with networks and volumes in each situation, and how it reports them (rorg/core/object_plans.py)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from rorg.core.desired import desire
from rorg.core.incremental import plan_all
from rorg.core.memory import Memory
from rorg.core.objects import changed_options, found_object, object_labels, object_views
from rorg.core.observed import Container, FoundObject, FoundObjects, Observed
from rorg.core.situation import Situation
from rorg.core.wanted import Cause
from rorg.model.catalog import Catalog, Idle, Service
from rorg.model.objects import EngineObject

LAB = EngineObject("network", "lab", "robot_lab", {"driver": "bridge"})
MAPS = EngineObject("volume", "maps", "robot_maps")
BASE = Service("base", spec={"image": "x", "networks": {"robot_lab": {}}, "volumes": ["robot_maps:/maps"]})


def made(declared: EngineObject, owner: str = "robot", **more: Any) -> FoundObject:
    """An object that was made from what is declared."""
    found = found_object(declared.kind, declared.called, "1", object_labels(declared, owner))
    return replace(found, **more)


def box(service: str = "base", state: str = "running", *networks: str) -> Container:
    return Container(service, service, service, state, networks=dict.fromkeys(networks, "1"))


def situation(
    *found: FoundObject,
    networks: tuple[EngineObject, ...] = (LAB,),
    volumes: tuple[EngineObject, ...] = (MAPS,),
    service: Service = BASE,
    seen: tuple[Container, ...] = (),
    asked: tuple[str, ...] = ("network/robot_lab", "volume/robot_maps"),
    **more: Any,
) -> Situation:
    declared = {"networks": {n.name: n for n in networks}, "volumes": {v.name: v for v in volumes}}
    objects = FoundObjects({one.key: one for one in found}, frozenset(asked), complete=True)
    facts = {
        "desired": desire(Catalog(services={"base": service}, **declared)),
        "observed": Observed(seen, objects=objects),
        "memory": Memory(),
        "wanted": {"base": (Cause("always_on"),)},
        "urgent": frozenset(),
    }
    return Situation(**{"now": 100.0, "owner": "robot", **facts, **more})


def planned(*found: FoundObject, **more: Any) -> list[str]:
    """What happens to networks and volumes."""
    plan = plan_all(situation(*found, **more)).plan()
    lines = [f"{a.verb} {a.service}: {a.why}" for a in plan.actions if "/" in a.service]
    return lines + [f"{w.service} waits: {w.reason} ({w.code})" for w in plan.waitings if "/" in w.service]


def test_what_a_service_uses_is_made_once():
    assert planned() == ["create network/lab: base uses it", "create volume/maps: base uses it"]
    assert planned(made(LAB), made(MAPS)) == []
    first = next(a for a in plan_all(situation()).plan().actions if a.service == "base")
    assert first.after == ("network/lab", "volume/maps")
    urgent = plan_all(situation(urgent=frozenset({"base"}), service=replace(BASE, priority=70))).plan().actions[0]
    assert (urgent.urgent, urgent.priority) == (True, 70)


@pytest.mark.parametrize(
    ("idle", "seen", "needed"),
    [
        (Idle(), (), True),
        (Idle(action="remove"), (), False),
        (Idle(action="remove"), (box(),), False),
        (Idle(escalate=(5.0, "stop")), (), True),
        (Idle(escalate=(5.0, "remove")), (), False),
        (Idle(escalate=(5.0, "remove")), (box(state="exited"),), True),
    ],
)
def test_what_only_idle_services_use_is_made_if_they_keep_a_container(idle, seen, needed):
    lines = planned(service=replace(BASE, idle=idle), seen=seen, wanted={})
    assert lines == (["create network/lab: base uses it", "create volume/maps: base uses it"] if needed else [])


def test_what_rorg_may_not_make_is_waited_for():
    external = {"networks": (replace(LAB, external=True),), "volumes": ()}
    (missing,) = planned(**external)
    assert missing.startswith("network/lab waits: no network is called 'robot_lab', and rorg creates no external ones")
    assert missing.endswith("`docker network create robot_lab`, or remove `external` (blocked)")
    assert planned(made(LAB, ""), **external) == planned(made(LAB, "another"), **external) == []
    for owner, whose in (("", "was not made by rorg"), ("another", "belongs to another robot")):
        (line,) = planned(made(LAB, owner), volumes=())
        assert f"the network 'robot_lab' {whose}; try `external: true`" in line
    unknown = planned(asked=(), volumes=())
    assert unknown == ["network/lab waits: checking whether it exists ()"]
    assert planned(asked=(), volumes=(), service=replace(BASE, idle=Idle(action="remove")), wanted={}) == []


CHANGED = replace(LAB, spec={"driver": "macvlan", "internal": True})


def test_a_changed_network_is_made_again_once_nothing_is_connected():
    now = {"networks": (CHANGED,), "volumes": ()}
    replaced = ["remove network/lab: changed: driver, internal", "create network/lab: changed: driver, internal"]
    assert planned(made(LAB), **now) == replaced
    assert planned(made(LAB), seen=(box("base", "exited", "robot_lab"),), **now) == replaced
    assert planned(made(LAB), seen=(box("base", "running", "other"),), **now) == replaced
    (line,) = planned(made(LAB), seen=tuple(box(n, "running", "robot_lab") for n in ("base", "a", "b", "c")), **now)
    assert line.endswith("it is recreated once nothing is connected to it; connected: a, b, base and 1 more (deferred)")
    (kept,) = planned(made(MAPS), networks=(), volumes=(replace(MAPS, spec={"driver": "nfs"}),))
    assert "changed: driver; it holds data, so it stays as it is; try `docker volume rm robot_maps`" in kept


def test_what_no_manifest_declares_goes_once_nothing_is_connected():
    none = {"networks": (), "volumes": (), "service": Service("base", spec={"image": "x"})}
    assert planned(made(LAB), **none) == ["remove network/robot_lab: no manifest declares it"]
    assert planned(made(LAB, "another"), **none) == planned(made(MAPS), **none) == []
    assert planned(made(MAPS), purge=True, **none) == ["remove volume/robot_maps: the robot is taken down"]
    assert planned(made(LAB), purge=True, **none) == ["remove network/robot_lab: no manifest declares it"]
    assert planned(made(LAB), networks=(), volumes=()) == [], "a service names it"
    gone = {"networks": (), "volumes": (), "wanted": {}, "service": replace(BASE, idle=Idle(action="remove"))}
    assert planned(made(LAB), **gone) == ["remove network/robot_lab: no manifest declares it"]
    withheld = planned(made(LAB), removals=False, **none)
    assert withheld == ["network/robot_lab waits: not declared; its removal is withheld until the manifests load ()"]


def test_a_found_object_is_ours_by_its_labels():
    ours = made(LAB)
    assert (ours.owner, ours.name, ours.key) == ("robot", "lab", "network/robot_lab")
    anonymous = found_object("volume", "f00", "", {"rorg.io/owner": "robot"})
    assert (anonymous.owner, anonymous.name) == ("", "")
    assert changed_options(LAB, ours) == ()
    assert changed_options(CHANGED, ours) == ("driver", "internal")
    assert changed_options(CHANGED, replace(ours, declared="{")) == ("digest",)
    assert changed_options(LAB, replace(ours, digest="v0:1")) == ()
    bare = made(MAPS)
    assert changed_options(replace(MAPS, spec={"driver": "nfs"}), bare) == ("driver",)
    secret = replace(LAB, spec={"driver": "bridge", "driver_opts": {"password": "a"}, "labels": {"team": "arm"}})
    assert object_labels(secret, "robot")["team"] == "arm"
    assert '"driver_opts.password":"sha256:' in object_labels(secret, "robot")["rorg.io/declared"]
    other = replace(secret, spec={**secret.spec, "driver_opts": {"password": "b"}})
    assert changed_options(other, made(secret)) == ("driver_opts.password",)


@pytest.mark.parametrize(
    ("found", "external", "asked", "state", "ours"),
    [
        ((made(LAB),), False, True, "present", True),
        ((made(LAB, "another"),), False, True, "foreign", False),
        ((made(LAB, "another"),), True, True, "present", False),
        ((), False, True, "none", False),
        ((), False, False, "unknown", False),
        ((made(LAB),), False, False, "present", True),
    ],
)
def test_each_object_has_a_state(found, external, asked, state, ours):
    robot = situation(
        *found, networks=(replace(LAB, external=external),), volumes=(), asked=("network/robot_lab",) if asked else ()
    )
    (view,) = object_views(robot, plan_all(robot).plan())
    assert (view["kind"], view["name"], view["engine_name"]) == ("network", "lab", "robot_lab")
    assert (view["state"], view["ours"], view["external"], view["declared"]) == (state, ours, external, True)
    assert view["services"] == ["base"]
    assert bool(view["message"]) is (state in ("foreign", "unknown"))


def test_what_is_left_of_rorgs_is_reported_too():
    left = made(MAPS, called="old_maps", name="old")
    unnamed = made(MAPS, called="a_maps", name="")
    robot = situation(left, unnamed, made(LAB, "another", called="theirs"), volumes=())
    views = object_views(robot, plan_all(robot).plan())
    assert [(v["kind"], v["name"], v["state"], v["declared"], v["ours"], v["external"]) for v in views] == [
        ("network", "lab", "none", True, False, False),
        ("volume", "a_maps", "present", False, True, False),
        ("volume", "old", "present", False, True, False),
    ]
    nothing = replace(robot, observed=Observed())
    assert [v["state"] for v in object_views(nothing, plan_all(nothing).plan())] == ["unknown"]
