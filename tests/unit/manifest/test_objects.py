"""Networks and volumes as manifests declare them: what services write becomes what the engine calls it, and what is
wrong is said at its place. A tree without any is what it was."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from robots import write_tree

from rorg.core.desired import desire
from rorg.core.objects import changed_options, declared_options, found_object, object_labels
from rorg.core.observed import FoundObjects
from rorg.engines.docker.objects import find, network_body, volume_body
from rorg.engines.observe_objects import ObjectObserver
from rorg.errors import EngineError
from rorg.manifest.load import load

SERVICE = {
    "container": {
        "networks": {"ros": {"aliases": ["base"]}, "default": {"aliases": ["nav"]}, "site": None},
        "volumes": ["maps:/maps:ro", {"type": "volume", "source": "maps", "target": "/more"}, "other:/o", "/unnamed"],
    }
}
NETWORKS = {"ros": {"name": "lab_ros"}, "default": {"name": "lab_default"}}
VOLUMES = {"maps": {"name": "lab_maps", "driver_opts": {"type": "cifs", "o": "password=hunter22"}}}


def loaded(folder: Path, services: dict, engine: str = "", **kinds: dict):
    return load(write_tree(folder, services, **kinds), engine=engine)


def test_services_are_rendered_with_what_the_engine_calls_them(tmp_path):
    found = loaded(
        tmp_path, {"nav": SERVICE, "lidar": {"container": {"network_mode": "ros"}}}, networks=NETWORKS, volumes=VOLUMES
    )
    assert not found.diagnostics
    spec = found.catalog.services["nav"].spec
    assert spec["networks"] == {"lab_ros": {"aliases": ["base"]}, "lab_default": {"aliases": ["nav"]}, "site": {}}
    assert spec["volumes"][0] == "lab_maps:/maps:ro"
    assert spec["volumes"][1]["source"] == "lab_maps"
    assert spec["volumes"][2:] == ["other:/o", "/unnamed"]
    assert found.catalog.services["lidar"].spec["network_mode"] == "lab_ros"
    desired = desire(found.catalog)
    assert desired.uses == {"nav": ("network/ros", "network/default", "volume/maps"), "lidar": ("network/ros",)}
    assert desired.keys == {"network/lab_ros", "network/lab_default", "volume/lab_maps"}


def test_a_tree_without_any_means_what_it_meant(tmp_path):
    """By the digest and the fingerprint of before there were such kinds: nothing is made anew by an upgrade."""
    spec = {"image": "img", "container": {"networks": ["site"], "volumes": ["data:/data"]}}
    catalog = loaded(tmp_path, {"nav": spec}).catalog
    assert desire(catalog).digests["nav"] == "v1:b1e7389f9d0d08d79de0d963a476e4eb"
    assert catalog.fingerprint == "dff9ae9ec2b643b9"


WRONG = {
    "network: subnet": ({"ipam": {"config": [{"subnet": "172.28.0.1/16"}]}}, "has host bits set"),
    "network: gateway": ({"ipam": {"config": [{"subnet": "172.28.0.0/16", "gateway": "10.0.0.1"}]}}, "is not in"),
    "network: range": ({"ipam": {"config": [{"ip_range": "172.28.0.0/16"}]}}, "need a subnet"),
    "network: external": ({"external": True, "driver": "bridge"}, "driver and external exclude each other"),
    "network: own": ({"name": "host"}, "write network_mode: host"),
    "network: label": ({"labels": {"rorg.io/owner": "me"}}, "rorg's own"),
    "volume: key": ({"driver_opt": {}}, "unknown key 'driver_opt'"),
    "volume: name": ({"name": "a b"}, "must match"),
    "volume: external": ({"external": True, "labels": {"a": "b"}}, "labels and external exclude each other"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_at_its_place(tmp_path, case):
    spec, said = WRONG[case]
    kind = case.partition(":")[0]
    found = loaded(tmp_path, {"nav": {}}, **{f"{kind}s": {"one": spec}})
    (error,) = found.errors
    assert error.where.file == str(tmp_path / f"{kind}s/one.yaml")
    assert error.where.line > 4
    assert said in f"{error.message}; try {error.remedy}"


def test_two_are_not_called_the_same(tmp_path):
    found = loaded(tmp_path, {"nav": {}}, networks={"ros": {"name": "same"}, "same": {}})
    assert [d.message for d in found.errors] == ["the network 'ros' is called 'same' too"]


def test_the_default_network_takes_options_where_it_is_declared(tmp_path):
    service = {"container": {"networks": {"default": {"aliases": ["nav"]}}}}
    (error,) = loaded(tmp_path / "bare", {"nav": service}).errors
    assert "no Network declares it" in error.message
    assert loaded(tmp_path / "declared", {"nav": service}, networks={"default": {}}).catalog


def test_a_name_that_is_almost_declared_is_a_warning(tmp_path):
    service = {"container": {"networks": ["roz"], "volumes": ["map:/maps", "data:/data"]}}
    kinds = {"networks": {"ros": {}, "hosts": {}}, "volumes": {"maps": {"name": "lab_maps"}}}
    found = loaded(tmp_path, {"nav": service, "plain": {}}, **kinds)
    assert found.catalog
    assert [(d.message, d.remedy) for d in found.diagnostics if d.severity == "warning"] == [
        ("no Volume is called 'map'", "'maps'")
    ]


def test_the_process_engine_says_once_what_it_leaves_out(tmp_path):
    kinds = {"networks": {"ros": {}, "can": {}}, "volumes": {"maps": {}}}
    found = loaded(tmp_path, {"nav": {"command": "python3"}}, "process", **kinds)
    told = [d.message for d in found.diagnostics if "process engine" in d.message]
    assert len(told) == 2
    assert found.catalog


def test_a_secret_of_a_driver_is_in_no_label(tmp_path):
    one = loaded(tmp_path, {"nav": {}}, volumes=VOLUMES).catalog.volumes["maps"]
    assert "hunter22" not in str(object_labels(one, "me"))
    assert "hunter22" not in str(declared_options(one))
    assert volume_body("lab_maps", one.spec, {})["DriverOpts"]["o"] == "password=hunter22"


def test_only_what_is_declared_is_sent_and_compared(tmp_path):
    spec = {
        "driver": "macvlan",
        "driver_opts": {"parent": "eth0"},
        "internal": True,
        "attachable": True,
        "enable_ipv6": False,
        "ipam": {
            "config": [{"subnet": "10.1.0.0/24", "gateway": "10.1.0.1", "ip_range": "10.1.0.128/25"}],
            "options": {"a": "b"},
        },
    }
    spec["ipam"]["config"][0]["aux_addresses"] = {"cam": "10.1.0.9"}
    networks = loaded(tmp_path, {"nav": {}}, networks={"lan": spec, "bare": {}}).catalog.networks
    assert network_body("bare", networks["bare"].spec, {}) == {"Name": "bare", "CheckDuplicate": True, "Labels": {}}
    assert network_body("lan", networks["lan"].spec, {"k": "v"}) == {
        "Name": "lan",
        "CheckDuplicate": True,
        "Labels": {"k": "v"},
        "Driver": "macvlan",
        "Options": {"parent": "eth0"},
        "Internal": True,
        "Attachable": True,
        "EnableIPv6": False,
        "IPAM": {
            "Driver": "default",
            "Config": [
                {
                    "Subnet": "10.1.0.0/24",
                    "Gateway": "10.1.0.1",
                    "IPRange": "10.1.0.128/25",
                    "AuxiliaryAddresses": {"cam": "10.1.0.9"},
                }
            ],
            "Options": {"a": "b"},
        },
    }
    made = found_object("network", "lan", "id", object_labels(networks["lan"], "me"))
    assert made.owner == "me"
    assert changed_options(networks["lan"], made) == ()
    assert changed_options(networks["bare"], made) == (
        "attachable",
        "driver",
        "driver_opts.parent",
        "enable_ipv6",
        "internal",
        "ipam",
    )


# -- the cache of what is there --------------------------------------------------------------------------------


class Counting:
    """An engine that counts what it is asked."""

    def __init__(self) -> None:
        self.asked: list[frozenset[str]] = []
        self.error = False

    def find_objects(self, keys):
        self.asked.append(frozenset(keys))
        if self.error:
            raise EngineError("list networks", "not spoken here")
        return FoundObjects({}, frozenset(keys), complete=True)

    def object_events(self, stop):
        yield
        stop.wait()


def test_a_robot_without_any_costs_one_look(tmp_path):
    engine = Counting()
    observer = ObjectObserver(engine, lambda: None)
    for _ in range(3):
        observer.look_for(frozenset())
        observer.check()
    assert engine.asked == [frozenset()]
    assert observer.snapshot().complete


def test_a_pass_asks_nothing_where_all_is_known():
    engine, woken = Counting(), threading.Event()
    observer = ObjectObserver(engine, woken.set)
    observer.start()
    try:
        observer.look_for({"network/ros"})
        assert woken.wait(60)
        found = observer.snapshot()
        assert found.asked == {"network/ros"}
        looks = observer.looks
        for _ in range(20):
            observer.look_for({"network/ros"})
            assert observer.snapshot() is found
        assert observer.looks <= looks + 1, "the one with which the stream of events begins"
    finally:
        observer.stop()


def test_a_driver_of_volumes_that_hangs_holds_up_no_network():
    class Hanging:
        def get(self, path, timeout=None):
            if path == "/volumes":
                assert timeout, "it would wait for ever"
                raise TimeoutError
            return [{"Name": "ros", "Id": "n1", "Labels": {}}]

    found = find(Hanging(), "me", {"network/ros", "volume/maps"})
    assert found.complete
    assert found.found.keys() == found.asked == {"network/ros"}
    assert "volumes" in found.error


def test_an_engine_that_cannot_say_holds_nobody_else_up():
    engine = Counting()
    engine.error = True
    observer = ObjectObserver(engine, lambda: None)
    observer.check()
    assert observer.snapshot().complete
    assert "not spoken here" in observer.snapshot().error
