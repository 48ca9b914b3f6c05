"""Drivers and their devices: who must wait for one, and what a container is given."""

from __future__ import annotations

from collections.abc import Mapping

from rorg.core.desired import Desired
from rorg.core.digest import canonical, declared_of
from rorg.core.observed import Container
from rorg.model.catalog import Service, Spec
from rorg.model.devices import Device, Plugged

NODES = "device_nodes"
"""What has changed of a container whose device is another node now."""

UNKNOWN = Plugged(problem="is being looked for")


def unplugged(desired: Desired, found: Mapping[Device, Plugged]) -> dict[str, str]:
    """Services of which a device cannot be used, each with why."""
    services = desired.catalog.services
    return {
        name: f"{device} {why}"
        for name in desired.drivers
        for device in reversed(services[name].devices)
        if (why := found.get(device, UNKNOWN if device.udev else Plugged()).problem)
    }


def nodes_of(service: Service, found: Mapping[Device, Plugged]) -> str:
    """What its container is given, as a label has it: identity of each device -> its node; empty where one is not known
    or not there."""
    if not service.devices or any(d not in found or found[d].problem for d in service.devices):
        return ""
    return canonical({d.identity: str(found[d]) for d in service.devices})


def replugged(container: Container, nodes: str) -> bool:
    """Whether a container was given another node for one of its devices than there is now."""
    if not nodes or not container.devices or nodes == container.devices:
        return False
    given, now = declared_of(container.devices), declared_of(nodes)
    return any(given.get(identity, node) != node for identity, node in now.items())


def given(spec: Spec, service: Service, found: Mapping[Device, Plugged]) -> Spec:
    """Its container as it is to be made now: with the nodes of what is known by its attributes. Paths stay: the engine
    follows them at every start."""
    nodes = {
        d.text: found[d].node + d.text[len(d.identity) :]
        for d in service.devices
        if d.udev and d in found and found[d].node
    }
    return {**spec, "devices": [nodes.get(text, text) for text in spec["devices"]]} if nodes else spec
