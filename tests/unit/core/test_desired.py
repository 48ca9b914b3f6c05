"""What is derived from a tree before anything is observed: relations between services, editions, and what `rorg down`
wants."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rorg.core.desired import GONE, desire, teardown
from rorg.model.catalog import Catalog, Group, Image, Request, Service, Updating
from rorg.model.devices import Device
from rorg.model.objects import EngineObject
from rorg.model.policy import Policy
from rorg.model.probe import Probe
from rorg.model.ros import RosParameters
from rorg.model.run_directory import RUN

X = {"image": "x"}
META = Service("developer", meta=True)


def tree(*services: Service, **more: object) -> Catalog:
    return Catalog(services={s.name: s for s in (META, *services)}, **more)


def made(name: str, **more: object) -> Service:
    return Service(name, **{"spec": X, **more})


def test_a_conflict_counts_for_both_sides():
    found = desire(tree(made("a", conflicts=("b", "gone", "a")), made("b"), made("c")))
    assert found.conflicts == {"developer": (), "a": ("b",), "b": ("a",), "c": ()}
    assert found.rivals == {"a": {"b"}, "b": {"a"}}


def test_who_shares_a_resource_is_a_rival_of_all_who_do():
    found = desire(tree(made("a", exclusive={"gpu": 1}), made("b", exclusive={"gpu": 2, "can0": 1}), made("c")))
    assert found.sharers == {"gpu": ("a", "b"), "can0": ("b",)}
    assert found.rivals == {"a": {"a", "b"}, "b": {"a", "b"}}


def test_the_order_has_needs_first():
    found = desire(tree(made("a", needs=("c", "elsewhere")), made("b", needs=("c",)), made("c")))
    assert found.order.index("c") < found.order.index("a")
    assert set(found.order) == {"developer", "a", "b", "c"}
    assert found.dependants == {"developer": (), "a": (), "b": (), "c": ("a", "b")}


def test_a_set_has_several_services_that_can_change():
    alone, arm = Updating(atomic="alone"), Updating(atomic="arm")
    services = made("a", update=arm), made("b", update=arm), made("c", update=alone), made("d")
    found = desire(tree(*services, Service("tour", meta=True, update=arm)))
    assert found.sets == {"arm": ("a", "b")}


def test_only_what_has_a_container_has_a_digest():
    found = desire(tree(made("a"), made("b", spec={"image": "y"}), Service("tour", meta=True)))
    for known in (found.digests, found.editions, found.declared):
        assert set(known) == {"a", "b"}
        assert known["a"] != known["b"]


@pytest.mark.parametrize(
    "other",
    [
        {"spec": {"image": "y"}},
        {"ready": Probe("tcp", 80)},
        {"ready": Probe("tcp", 81)},
        {"ready": Probe("all", 0, parts=(Probe("tcp", 80), Probe("tcp", 81)))},
        {"ready": Probe("all", 0, parts=(Probe("tcp", 80), Probe("tcp", 82)))},
        {"live": Probe("tcp", 80)},
    ],
)
def test_an_edition_changes_with_all_that_a_trial_depends_on(other):
    (was,), (now,) = (desire(tree(s)).editions.values() for s in (made("a"), made("a", **other)))
    assert was != now
    assert desire(tree(made("a")), contents={"a": {"/map": "1"}}).editions["a"] != was


@pytest.mark.parametrize(
    ("service", "edition"),
    [
        (made("a"), "v1:a3045f57dcce5df6a06de149fd04e246"),
        (made("a", ready=Probe("ros_node", "/a", graph="ros")), "v1:1a210a6a8b09b29a818309dab523d0c4"),
        (
            made("a", ready=Probe("all", 0, parts=(Probe("tcp", 80), Probe("log", "up"))), live=Probe("tcp", 80)),
            "v1:f5ca02f435145034dcb770ca68337220",
        ),
    ],
)
def test_an_edition_is_what_it_was_in_earlier_versions(service, edition):
    """Editions are kept on disk. If one changed with an update of rorg, its service would be on trial once more."""
    assert desire(tree(service)).editions["a"] == edition


def test_what_calls_rorg_gets_the_directory_of_its_socket():
    spec = {
        "image": RUN,
        "command": ["call", f"{RUN}/a"],
        "volumes": [f"{RUN}/a:/run"],
        "environment": {"RORG": f"unix://{RUN}", "N": "1"},
    }
    caller = made("a", spec=spec, may_request=("b",))
    expected = {
        "image": RUN,
        "command": ["call", "/r/a"],
        "volumes": ["/r/a:/run"],
        "environment": {"RORG": "unix:///r", "N": "1"},
    }
    assert desire(tree(caller), run="/r").catalog.services["a"].spec == expected
    ros2 = made("a", spec=spec, ros=RosParameters("ros"), domain=0)
    assert desire(tree(ros2), run="/r").catalog.services["a"].spec == expected
    for other in (made("a", spec=spec), replace(ros2, domain=None), replace(ros2, ros=None)):
        assert desire(tree(other), run="/r").catalog.services["a"].spec == spec
    assert desire(tree(replace(caller, spec=None), made("b"))).digests.keys() == {"b"}


def test_a_tree_without_callers_is_not_copied():
    catalog = tree(made("a"))
    assert desire(catalog).catalog.services["a"] is catalog.services["a"]


def test_images_of_the_tree_are_named_by_their_content():
    base = Image("base", None, "", {}, None, "")
    catalog = tree(made("a", spec={"image": "base:latest"}), made("b"), images={"base": base}, fingerprint="f" * 16)
    found = desire(catalog, images={"base": "base:0123"})
    assert found.catalog.services["a"].spec == {"image": "base:0123"}
    assert found.catalog.services["b"].spec == X
    assert found.catalog.images["base"].reference == "base:0123"
    assert len(found.catalog.fingerprint) == 16
    assert found.catalog.fingerprint != desire(catalog, images={"base": "base:4567"}).catalog.fingerprint
    assert desire(catalog).catalog.fingerprint == "f" * 16


def test_devices_probes_and_parameters_are_collected():
    usb, arm = Device("/dev/usb", "/dev/usb"), Device("/dev/arm", "/dev/arm")
    lock, values = Probe("exec", ("parked",)), RosParameters("ros", {"/a": 1})
    found = desire(
        tree(made("b", devices=(usb, arm)), made("a", devices=(usb,)), made("c", interlock=lock, ros=values), made("d"))
    )
    assert found.drivers == ("a", "b")
    assert found.devices == (arm, usb)
    assert found.interlocks == {"c": lock}
    other = desire(tree(made("c", ros=replace(values, values={"/a": 2}))))
    assert set(found.ros) == {"c"}
    assert found.ros != other.ros


def test_networks_and_volumes_know_who_uses_them():
    lab, maps = EngineObject("network", "lab", "robot_lab"), EngineObject("volume", "maps", "robot_maps")
    spec = {**X, "networks": {"robot_lab": {}, "other": {}}, "volumes": ["robot_maps:/maps", "other:/x"]}
    catalog = tree(made("a", spec=spec), made("b", spec={**X, "networks": {"robot_lab": {}}}), made("c"))
    found = desire(replace(catalog, networks={"lab": lab}, volumes={"maps": maps}))
    assert found.objects == {"network/lab": lab, "volume/maps": maps}
    assert found.keys == {"network/robot_lab", "volume/robot_maps"}
    assert found.uses == {"a": ("network/lab", "volume/maps"), "b": ("network/lab",)}
    assert found.users == {"network/lab": ("a", "b"), "volume/maps": ("a",)}
    assert desire(catalog).uses == {}


# -- rorg down -------------------------------------------------------------------------------------------------


def test_down_wants_nothing_and_keeps_nothing():
    catalog = tree(
        made("a", always_on=True),
        Service("tour", meta=True),
        networks={"lab": EngineObject("network", "lab", "lab")},
        volumes={"maps": EngineObject("volume", "maps", "maps")},
        requests=(Request("r", "tour", ("a",), standing=True),),
        groups={"all": Group("all", ("a",))},
        policy=Policy(removals="confirm"),
        fingerprint="f" * 16,
    )
    before = desire(catalog, contents={"a": {"/map": "1"}})
    found = teardown(before, None)
    services = found.catalog.services
    assert (services["a"].always_on, services["a"].idle) == (False, GONE)
    assert services["tour"] == catalog.services["tour"]
    assert (found.catalog.networks, found.catalog.volumes, found.catalog.requests) == ({}, {}, ())
    assert found.catalog.policy.removals == "auto"
    assert found.catalog.fingerprint == before.catalog.fingerprint
    assert found.contents == {"a": {"/map": "1"}}


def test_down_without_a_readable_tree_goes_by_the_last_good_one():
    nothing, last = desire(replace(tree(), fingerprint="now")), tree(made("a"), fingerprint="last")
    assert set(teardown(nothing, last).catalog.services) == {"developer", "a"}
    assert set(teardown(nothing, None).catalog.services) == {"developer"}
    assert set(teardown(desire(tree(made("b"))), last).catalog.services) == {"developer", "b"}
