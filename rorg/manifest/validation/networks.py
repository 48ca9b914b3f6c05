"""Networks: which services reach each other, and which take each other's ports."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from urllib.parse import urlsplit

from rorg.manifest.validation.robot import Finding, Robot, each, in_containers
from rorg.manifest.validation.subject import Subject
from rorg.model.ports import Published

LOCAL = ("localhost", "127.0.0.1", "::1", "")
URI = r"http://[^/\s]+:[0-9]+/?"
ANY = ("", "0.0.0.0", "::")
URL_HOST = re.compile(r"://([A-Za-z][\w.-]*)")
PLACE = re.compile(r"(?<![\w./:-])([A-Za-z][\w.-]*):([0-9]{4,5})(?![\w.])")
NAMES_HOST = re.compile(r"(?:^|_)(HOST|HOSTNAME|SERVER|BROKER|ADDRESS)$")
FIRST_FREE = 1024
NOWHERE = re.compile(r"0\.0\.0\.0|::|(eth|wlan|usb|br)[0-9]+|(en|wl)[opsx][0-9]\w*")
"""No address, or the name of an interface."""


def _host_names(subject: Subject) -> Iterator[Finding]:
    """Host names that nothing can resolve: ROS 1 tells them to other nodes, and calls itself by them. And ROS programs
    without any network."""
    name = str(subject.options.get("hostname") or "")
    known = any(str(line).startswith(f"{name}:") for line in subject.options.get("extra_hosts") or ())
    if name and subject.network == "host" and not known and {"ROS_IP", "ROS_HOSTNAME"}.isdisjoint(subject.env):
        said = "the ROS master cannot reach it by that name, and it ends" if subject.ros1 else "nothing knows that name"
        message = f"hostname '{name}' under network_mode: host: {said}"
        severity = "error" if subject.ros1 else "warning"
        yield Finding("hostname-with-host-network", subject.option("hostname"), message, severity=severity)
    if subject.ros and subject.network == "none":
        yield Finding("ros-without-network", subject.option("network_mode"), f"'{subject.name}' has no network")


def _mixed(robot: Robot) -> Iterator[Finding]:
    """ROS tells every node the addresses of all others, with any port: all must be on one network."""
    for subject in (s for s in robot.subjects if s.ros and s.network not in ("host", "none")):
        if subject.network.startswith(("container:", "service:")):
            continue
        others = (o for o in robot.subjects if (o.ros1 and subject.ros1) or (o.ros2 and subject.ros2))
        beside = next((o for o in others if o.network == "host"), None)
        name = subject.env.get("ROS_IP") or subject.env.get("ROS_HOSTNAME", "")
        if beside:
            networks = ", ".join(subject.options.get("networks") or ()) or subject.network
            message = f"'{subject.name}' is on another network ({networks}) than '{beside.name}' (host)"
        elif subject.ros1 and name in LOCAL and (name or subject.network in ("bridge", "default")):
            said = f"is '{name}'" if name else "is not set"
            message = f"ROS 1 on {subject.network}, and the address where others reach it {said}"
        else:
            continue
        remedy = "network_mode: host for all of them, or ROS_IP with the container's address"
        yield Finding("mixed-networks", subject.option("network_mode"), message, remedy)


def _local_only(robot: Robot) -> Iterator[Finding]:
    """ROS 2 programs that search only their own machine: each container counts as a machine."""
    for subject in (s for s in robot.ros2 if s.network not in ("host", "none") and ":" not in s.network):
        local = subject.env.get("ROS_LOCALHOST_ONLY") == "1"
        name = "ROS_LOCALHOST_ONLY" if local else "ROS_AUTOMATIC_DISCOVERY_RANGE"
        if len(robot.ros2) > 1 and (local or subject.env.get(name) == "LOCALHOST"):
            message = f"{name} keeps '{subject.name}' within its own container"
            yield Finding("ros2-local-on-bridge", subject.option("network_mode"), message)


def _masters(robot: Robot) -> Iterator[Finding]:
    """The address of the ROS 1 master, and the name at which it calls back."""
    for subject in robot.ros1:
        uri, env = subject.env.get("ROS_MASTER_URI", ""), subject.env
        host = urlsplit(uri).hostname or ""
        if uri and not re.fullmatch(URI, uri):
            message = f"'{uri}' is not the address of a ROS master"
            yield Finding("ros-master-uri", subject.variable("ROS_MASTER_URI"), message)
        elif {"ROS_IP", "ROS_HOSTNAME"} <= set(env):
            message = "both ROS_IP and ROS_HOSTNAME are set, and ROS_IP is ignored"
            yield Finding("ros-ip-and-hostname", subject.variable("ROS_IP"), message)
        elif host not in LOCAL and env.get("ROS_HOSTNAME", env.get("ROS_IP")) in LOCAL[:-1]:
            message = f"the master is on '{host}', and it would call nodes back at localhost"
            yield Finding("ros-master-elsewhere", subject.variable("ROS_MASTER_URI"), message)


def _differing(robot: Robot) -> Iterator[Finding]:
    """Nodes of one robot that register with different masters."""
    uris = {s.name: uri for s in robot.ros1 if re.fullmatch(URI, uri := s.env.get("ROS_MASTER_URI", ""))}
    alike = {n: re.sub(r"//(127\.0\.0\.1|localhost)\b", "//localhost", u.rstrip("/")) for n, u in uris.items()}
    known = [s for s in robot.ros1 if s.name in alike]
    own = [alike[s.name] for s in robot.masters if s.name in alike]
    counts = Counter(alike.values())
    usual = own[0] if own else max(counts, key=lambda v: (counts[v], v), default="")
    for subject in (s for s in known if alike[s.name] != usual):
        message = f"'{subject.name}' has its ROS master at {uris[subject.name]}, the others at {usual}"
        yield Finding("ros-masters-differ", subject.variable("ROS_MASTER_URI"), message)


def _ports(robot: Robot) -> Iterator[Finding]:
    """The same port of the machine, published by two services that may run at the same time."""
    taken: list[tuple[Subject, Published]] = []
    for subject in robot.subjects:
        told = set[int]()
        for index, port in subject.published:
            rivals = (s for s, p in taken if s is not subject and _same(p, port) and not robot.apart(s, subject))
            first = next(rivals, None)
            taken.append((subject, port))
            if first and index not in told:
                told.add(index)
                message = f"port {port.host} of this machine is published by '{first.name}' too"
                yield Finding("port-taken-twice", subject.item("ports", subject.options["ports"][index]), message)


def _same(one: Published, other: Published) -> bool:
    address = one.address == other.address or one.address in ANY or other.address in ANY
    return one.host == other.host and address and one.port.partition("/")[2] == other.port.partition("/")[2]


def _probed(robot: Robot) -> Iterator[Finding]:
    """Services that are probed at the same port of the host: one answers for the other."""
    first: dict[str, Subject] = {}
    for subject, asked in ((s, a) for s in robot.subjects if s.network == "host" for a in s.asked_ready):
        if asked.probe.kind != "tcp":
            continue
        target = str(asked.probe.target).replace("localhost", "127.0.0.1")
        other = first.setdefault(target, subject)
        if other is not subject and not robot.apart(other, subject):
            message = f"'{other.name}' is probed by port {target.rpartition(':')[2]} too: it answers for this one"
            yield Finding("port-probed-twice", subject.at(*asked.path), message)


def _names(robot: Robot) -> Iterator[Finding]:
    """Names of services as names of hosts: only the engine's own networks resolve them."""
    names = {n for s in robot.subjects for n in (s.name, s.service.container_name)}
    for subject in (s for s in robot.subjects if robot.whose(s, "network_mode") == "host"):
        known = {str(line).replace("=", ":").partition(":")[0] for line in subject.options.get("extra_hosts") or ()}
        variables = ((n, host) for n, value in subject.env.items() for host in sorted(_hosts(n, value) & names))
        words = (("", host) for word in subject.words for host in sorted(_hosts("", word) & names))
        told = set(known)
        for variable, host in (*variables, *words):
            if host not in told:
                told.add(host)
                where = subject.variable(variable) if variable else subject.command()
                message = f"network_mode: host resolves no '{host}', the name of a service, unless /etc/hosts has it"
                yield Finding("service-name-on-host-network", where, message)


@lru_cache(maxsize=2048)
def _hosts(variable: str, text: str) -> frozenset[str]:
    """The hosts that the value of a variable names, or a word of a command line if `variable` is empty."""
    hosts = set(URL_HOST.findall(text)) if "://" in text else set[str]()
    if variable and ":" in text:
        hosts |= {host for host, port in PLACE.findall(text) if int(port) >= FIRST_FREE}
    return frozenset(hosts | {text} if variable and NAMES_HOST.search(variable) else hosts)


def _addresses(subject: Subject) -> Iterator[Finding]:
    """Addresses that a node of ROS 1 announces, and at which nothing reaches it."""
    for name in ("ROS_IP", "ROS_HOSTNAME"):
        if NOWHERE.fullmatch(value := subject.env.get(name, "")):
            message = f"{name} is {value}, where no other machine can call the nodes of '{subject.name}'"
            yield Finding("ros-address", subject.variable(name), message)


CHECKS = (
    *(_mixed, _local_only, _masters, _differing, _ports, _probed),
    *map(each, (_host_names, _addresses)),
    in_containers(_names),
)
