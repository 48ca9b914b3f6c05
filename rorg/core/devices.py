"""Drivers and their devices: which service waits for a device, and which device nodes a container gets."""

from __future__ import annotations

from collections.abc import Mapping

from rorg.core.desired import Desired
from rorg.core.digest import canonical, declared_of
from rorg.core.observed import Container
from rorg.model.catalog import Service, Spec
from rorg.model.devices import Device, Plugged

NODES = "device_nodes"
"""Pseudo-option that differs if a device has another node now, e.g. after replugging."""

UNKNOWN = Plugged(problem="is being looked for")


def unplugged(desired: Desired, plugged: Mapping[Device, Plugged]) -> dict[str, str]:
    """Return services that cannot run because of a device, each with the reason."""
    services = desired.catalog.services
    return {
        name: f"{device} {why}"
        for name in desired.drivers
        for device in reversed(services[name].devices)
        if (why := plugged.get(device, UNKNOWN if device.udev else Plugged()).problem)
    }


def nodes_of(service: Service, plugged: Mapping[Device, Plugged]) -> str:
    """Return the device nodes for a container, as its label stores them: identity of each device -> node. "" if one of
    them is unknown or missing."""
    if not service.devices or any(d not in plugged or plugged[d].problem for d in service.devices):
        return ""
    return canonical({d.identity: str(plugged[d]) for d in service.devices})


def replugged(container: Container, nodes: str) -> bool:
    """Return whether a device of this container is at another node now."""
    if not nodes or not container.devices or nodes == container.devices:
        return False
    given, now = declared_of(container.devices), declared_of(nodes)
    return any(given.get(identity, node) != node for identity, node in now.items())


def given(spec: Spec, service: Service, plugged: Mapping[Device, Plugged]) -> Spec:
    """Return the spec with the current nodes of devices that are matched by attributes (udev). Devices given as paths
    stay: the engine resolves those at each start."""
    nodes = {
        d.text: plugged[d].node + d.text[len(d.identity) :]
        for d in service.devices
        if d.udev and d in plugged and plugged[d].node
    }
    return {**spec, "devices": [nodes.get(text, text) for text in spec["devices"]]} if nodes else spec
