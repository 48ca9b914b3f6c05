"""Services for any machine: what a Docker Swarm cannot give them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from rorg.manifest.rendered_container import CALLS
from rorg.manifest.validation.robot import Finding, Robot, each
from rorg.manifest.validation.subject import Subject
from rorg.model.diagnostics import Where
from rorg.model.engines import ENGINES, SWARM
from rorg.model.image_names import declared
from rorg.model.joining import SERVICE
from rorg.model.machines import ANYWHERE
from rorg.model.volumes import OF_TREE

HERE = ("exec", "file")
"""Kinds of probes that look inside a container, which the Swarm's managers cannot."""


def _options(subject: Subject) -> Iterator[Finding]:
    able = ENGINES[SWARM].options or frozenset()
    for option in sorted(subject.options.keys() - able - {*subject.service.defaults}):
        yield _lacks(subject, subject.option(option), option)
    network = str(subject.options.get("network_mode") or "")
    if network.startswith((SERVICE, "container:")):
        yield _lacks(subject, subject.option("network_mode"), f"network_mode: {network}")


def _lacks(subject: Subject, where: Where, what: str) -> Finding:
    return Finding("not-on-swarm", where, f"'{subject.name}' may run on any machine, and a Swarm has no {what}")


def _fields(subject: Subject) -> Iterator[Finding]:
    service, spec = subject.service, subject.source.spec
    if service.driver:
        yield _lacks(subject, subject.at("driver"), "driver of hardware")
    if service.idle.action in ("pause", "deactivate"):
        yield _lacks(subject, subject.at("idle", "action"), service.idle.action)
    if service.on_change not in ("restart", "none"):
        yield _lacks(subject, subject.at("on_change"), f"signal ({service.on_change})")
    for field in (name for name in CALLS if getattr(spec, name)):
        yield _lacks(subject, subject.at(field), f"socket of rorg, which {field} needs")
    for asked in (a for a in subject.asked if a.probe.kind in HERE):
        yield _lacks(subject, subject.at(*asked.path), f"`{asked.probe.kind}` in a container")


def _exclusive(subject: Subject) -> Iterator[Finding]:
    if subject.service.exclusive:
        message = f"'{subject.name}' is to be the only user of {', '.join(subject.service.exclusive)}"
        yield Finding("exclusive-anywhere", subject.at("exclusive"), message)


def _volumes(subject: Subject) -> Iterator[Finding]:
    for mount in subject.mounts:
        where = subject.volume(mount)
        if mount.source and not mount.path:
            message = f"the volume {mount.source} is on one node, and '{subject.name}' may run on any"
            yield Finding("volume-of-one-node", where, message)
        elif mount in subject.mounts_of_tree and not _travels(subject, mount.target):
            message = f"{mount.path} is on this computer, and '{subject.name}' may run on any"
            yield Finding("tree-of-one-node", where, message)
        elif mount.path and mount not in subject.mounts_of_tree:
            yield Finding("path-of-node", where, f"{mount.path} must be on every node that may run '{subject.name}'")


def _travels(subject: Subject, target: str) -> bool:
    volumes = subject.options.get("volumes") or ()
    return any(isinstance(v, dict) and v["type"] == OF_TREE and v["target"] == target for v in volumes)


def _images(robot: Robot) -> Iterator[Finding]:
    for subject in robot.subjects:
        image = declared(str(subject.options.get("image") or ""), robot.catalog.images)
        if subject.service.machine == ANYWHERE and image:
            message = f"the image {image} is built on this computer, and '{subject.name}' may run on any"
            yield Finding("image-of-one-node", subject.at("image"), message)


def _anywhere(check: Callable[[Subject], Iterator[Finding]]) -> Callable[[Subject], Iterator[Finding]]:
    def run(subject: Subject) -> Iterator[Finding]:
        return check(subject) if subject.service.machine == ANYWHERE else iter(())

    return run


CHECKS = (_images, *(each(_anywhere(check)) for check in (_options, _fields, _exclusive, _volumes)))
