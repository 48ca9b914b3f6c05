"""ROS 2: services find each other only in the same domain, and exchange data by shared memory only with the same
settings."""

from __future__ import annotations

import re
from collections.abc import Iterator

from rorg.manifest.validation.robot import Finding, Robot, each, minority
from rorg.manifest.validation.subject import Subject
from rorg.manifest.validation.texts import text_of
from rorg.manifest.validation.variables import QUOTED, RMW
from rorg.model.diagnostics import HINT
from rorg.model.ros import RELEASES

MOST_DOMAIN = 232
"""Above it there are no ports: the first port of a domain is 7400 + 250 * domain."""
TAKEN = range(102, 215)
"""Domains with ports that Linux uses for outgoing connections (net.ipv4.ip_local_port_range)."""
FAST = "rmw_fastrtps_cpp"
SHARED = ("", FAST, "rmw_fastrtps_dynamic_cpp")
"""Implementations that use shared memory by default, and are compatible with each other."""
_FOUND = "not all of them are found from other machines"
ALIKE = {
    "ROS_DOMAIN_ID": ("ros2-domain-mismatch", "0", "they do not see each other"),
    "RMW_IMPLEMENTATION": ("ros2-rmw-mismatch", FAST, "they may not understand each other"),
    "ROS_LOCALHOST_ONLY": ("ros2-discovery-mismatch", "", _FOUND),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": ("ros2-discovery-mismatch", "", f"{_FOUND}, and with OFF not at all"),
    "ROS_DISCOVERY_SERVER": ("ros2-discovery-mismatch", "", "they do not find each other"),
    "ROS_STATIC_PEERS": ("ros2-discovery-mismatch", "", "they look for others at different places"),
}
"""Variables that should be the same everywhere: the finding if they are not, the default, and the consequence."""
SMALLEST = 16 << 20
ZENOH = "rmw_zenoh_cpp"
ROUTERS = frozenset(("rmw_zenohd", "zenohd"))
BARE = re.compile(r"(docker\.io/)?(library/|osrf/)?ros:(humble|iron|jazzy)\b")
"""Official images that have only the middleware of Fast DDS."""
REMOTE = re.compile(r"(?<![\w.])(?!127\.|0\.)[0-9]{1,3}(\.[0-9]{1,3}){3}(?![\w.])")
SIM_TIME = re.compile(r"use_sim_time\W{1,3}true\b", re.IGNORECASE)
CLOCKS = re.compile(r"gazebo|gzserver|webots|isaac|\b(ign|gz|parameter_bridge|bag|ros1_bridge)\b|--clock|/clock")
"""Words that identify programs which publish simulated time, or have no time of their own."""
TIMELESS = frozenset(
    (
        *("static_transform_publisher", "teleop_twist_keyboard", "teleop_keyboard", "joy_node", "foxglove_bridge"),
        *("rosbridge_websocket", "micro_ros_agent", "rmw_zenohd", "topic_tools", "twist_mux"),
    )
)
"""Nodes that behave alike in both times."""
_UNLESS = ", unless its image sets it"


def _single(robot: Robot) -> Iterator[Finding]:
    """Values that are wrong for any participant."""
    for subject in robot.ros2:
        text = subject.env.get("ROS_DOMAIN_ID") or "0"
        where, size = subject.variable("ROS_DOMAIN_ID"), subject.options.get("shm_size")
        if QUOTED.fullmatch(text):
            continue  # quoted-variable says why it is no number
        if not re.fullmatch("[0-9]{1,9}", text) or int(text) > MOST_DOMAIN:
            message = f"ROS_DOMAIN_ID {text} is no number from 0 to {MOST_DOMAIN}: no node starts"
            yield Finding("ros2-domain-range", where, message)
        elif int(text) in TAKEN:
            message = f"ROS_DOMAIN_ID {text} has ports that any connection may take first: then a node does not start"
            yield Finding("ros2-domain-range", where, message)
        if size is not None and size < SMALLEST and subject.ipc != "host" and shares_memory(subject):
            message = f"shm_size {size} is too little for the shared memory of one participant"
            yield Finding("shm-too-small", subject.option("shm_size"), message)


def _differing(robot: Robot) -> Iterator[Finding]:
    """Variables that are not the same everywhere."""
    for name, (code, default, result) in ALIKE.items():
        values = {s.name: s.env.get(name) or default for s in robot.ros2}
        values = {n: FAST if value in SHARED[1:] else value for n, value in values.items()}
        for subject, usual in minority(robot.ros2, values):
            value = values[subject.name]
            said = value if subject.env.get(name) else f"not set, which is {value}," if value else "not set"
            zenoh = name == "RMW_IMPLEMENTATION" and "zenoh" in value + usual
            then = "they do not see each other" if zenoh else result
            message = f"{name} is {said} in '{subject.name}', and {usual or 'not set'} in others: {then}"
            message += "" if subject.env.get(name) else _UNLESS
            yield Finding(code, subject.variable(name), message, f"{usual} for all of them" if default else "")


def _releases(robot: Robot) -> Iterator[Finding]:
    matches = {s.name: RELEASES.search(s.env.get("ROS_DISTRO") or str(s.options.get("image", ""))) for s in robot.ros2}
    values = {name: match[1] for name, match in matches.items() if match}
    for subject, usual in minority([s for s in robot.ros2 if s.name in values], values):
        message = f"'{subject.name}' is of {values[subject.name]}, others of {usual}: they may not find each other"
        where = subject.variable("ROS_DISTRO") if "ROS_DISTRO" in subject.env else subject.at("image")
        yield Finding("ros2-release-mismatch", where, message, f"{usual} for all of them")


def shares_memory(subject: Subject) -> bool:
    """Whether its data goes through shared memory if possible."""
    env = subject.env
    transports = env.get("FASTDDS_BUILTIN_TRANSPORTS", "")
    own = "FASTRTPS_DEFAULT_PROFILES_FILE" in env or "FASTDDS_DEFAULT_PROFILES_FILE" in env
    return env.get("RMW_IMPLEMENTATION", "") in SHARED and not own and "UDP" not in transports.upper()


def _unsaid(subject: Subject) -> str:
    """The reservation about a service that does not name its middleware."""
    return "" if subject.env.get("RMW_IMPLEMENTATION") else ", if its middleware is Fast DDS, the usual one"


def _sharers(robot: Robot) -> dict[str, list[Subject]]:
    """Services that exchange data only by shared memory, by the owner of that memory: at the same address, each assumes
    that the other is on its own machine."""
    by_owner: dict[str, list[Subject]] = {}
    for subject in robot.ros2:
        if shares_memory(subject) and robot.whose(subject, "network_mode") == "host":
            by_owner.setdefault(robot.whose(subject, "ipc"), []).append(subject)
    return by_owner


def _memory(robot: Robot) -> Iterator[Finding]:
    sharers = _sharers(robot)
    alone = {name for name, members in sharers.items() if [s.name for s in members] == [name]}
    only = len(robot.ros2) == 1  # with whom it exchanges data, if with anyone, is not in the tree
    for name in sorted(alone)[:1]:
        (subject,) = sharers[name]
        others = ", ".join(f"'{other}'" for other in sorted(alone)[1:])
        beside = f", as {others} {'are' if len(alone) > 2 else 'is'}" if others else ""
        message = f"'{name}' is on the host's network with shared memory of its own{beside}: no data passes to or "
        message += f"from others{_unsaid(subject)}"
        yield Finding("ros2-host-net-private-ipc", subject.option("ipc"), message, severity=HINT if only else "")
    together = {s: whose for whose, members in sharers.items() if whose not in alone for s in members}
    values = {s.name: whose for s, whose in together.items()}
    for subject, usual in minority(together, values):
        message = f"'{subject.name}' has the shared memory of {values[subject.name]}, others that of {usual}: "
        message += f"no data passes between them{_unsaid(subject)}"
        yield Finding("ros2-host-net-private-ipc", subject.option("ipc"), message, "one ipc for all of them")


def _users(robot: Robot) -> Iterator[Finding]:
    for together in _sharers(robot).values():
        for subject, usual in minority(together, {s.name: s.uid for s in together}):
            message = f"'{subject.name}' runs as user {subject.uid}, others as {usual}: they exchange no data"
            message += _unsaid(subject)
            where = subject.option("user") if "user" in subject.options else subject.source.where("metadata", "name")
            yield Finding("ros2-mixed-uid", where, message, f'user: "{usual}" for all of them')


NEEDS_ROS2 = frozenset(("ros_rate", "lifecycle"))
"""Forms of probes that no ROS 1 master can answer."""
FIELDS = ("lifecycle", "parameter_files", "remap", "namespace", "domain", "rmw")
"""Fields of `ros` that only programs of ROS 2 have."""


def _unreported(robot: Robot) -> Iterator[Finding]:
    """Domains that nothing reports, although probes or managed nodes need it: one finding for each."""
    reported = {s.service.domain for s in robot.subjects if s.service.may_report_graph}
    for subject in (s for s in robot.subjects if s.service.domain not in (None, *reported)):
        managed, asked = subject.service.managed, subject.graph_probes
        if not (managed or asked):
            continue
        domain = f"domain {subject.service.domain}"
        reported.add(subject.service.domain)
        message = f"nothing reports the graph of {domain}, so rorg cannot " + (
            f"activate {', '.join(managed)}" if managed else f"ask '{asked[0].probe}' for '{subject.name}'"
        )
        where = subject.at("ros", "lifecycle") if managed else subject.at(*asked[0].path)
        remedy = f"a service of {domain} with `may_report_graph: true`, such as the node of clients/ros2"
        yield Finding("ros2-graph-unreported", where, message, remedy)


def _of_ros2_only(robot: Robot) -> Iterator[Finding]:
    """Fields and probes that mean nothing for a program of ROS 1."""
    for subject in (s for s in robot.subjects if s.service.domain is None):
        for asked in (a for a in subject.graph_probes if a.probe.kind in NEEDS_ROS2):
            message = f"'{subject.name}' is no program of ROS 2, and a ROS 1 master cannot answer {asked.probe.kind}"
            yield Finding("ros2-only", subject.at(*asked.path), message)
        ros = subject.source.spec.ros
        used = [name for name in FIELDS if ros and getattr(ros, name)]
        if used:
            message = f"'{subject.name}' is no program of ROS 2, so it has no use for {', '.join(used)}"
            yield Finding("ros2-only", subject.at("ros", used[0]), message)


def _routers(robot: Robot) -> Iterator[Finding]:
    """Zenoh without a router: nodes find each other only through it, unless their environment says how."""
    users = [s for s in robot.ros2 if s.env.get("RMW_IMPLEMENTATION") == ZENOH]
    alone = [s for s in users if not any(name.startswith("ZENOH_") for name in s.env)]
    routers = (s for s in robot.subjects if "zenoh" in str(s.options.get("image")) or ROUTERS & s.programs)
    if alone and next(routers, None) is None:
        message = f"'{alone[0].name}' finds others only through a router, and no service of this robot is one"
        yield Finding("zenoh-without-router", alone[0].variable("RMW_IMPLEMENTATION"), message)


def _missing(subject: Subject) -> Iterator[Finding]:
    """Middleware that the official images do not have, and servers beyond the machine that a node is limited to."""
    name, env = str(subject.options.get("image") or ""), subject.env
    rmw = env.get("RMW_IMPLEMENTATION", "")
    if BARE.match(name) and rmw in RMW and rmw not in SHARED and not re.search(r"\bapt(-get)?\b", subject.script):
        message = f"the official '{name}' has only Fast DDS: if your image is the same, it lacks {rmw}, and no node "
        message += "starts"
        yield Finding("rmw-not-in-image", subject.variable("RMW_IMPLEMENTATION"), message)
    far = next((n for n in ("ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS") if REMOTE.search(env.get(n, ""))), "")
    if far and env.get("ROS_LOCALHOST_ONLY") == "1":
        message = f"ROS_LOCALHOST_ONLY keeps '{subject.name}' on this machine, and {far} is {env[far]}"
        yield Finding("ros2-local-with-remote-server", subject.variable(far), message)


def _times(robot: Robot) -> Iterator[Finding]:
    """Simulated time in some services, while others do not mention it."""
    users = [s for s in robot.ros2 if SIM_TIME.search(text_of(s))]
    others = [s for s in robot.ros2 if s not in users and not TIMELESS & s.executables] if users else []
    others = [s for s in others if not CLOCKS.search(text_of(s))]
    if others:
        more = f" and {len(others) - 3} more" if len(others) > 3 else ""
        shown = ", ".join(f"'{s.name}'" for s in others[:3]) + more
        message = f"'{users[0].name}' uses simulated time, and {shown} real time, unless their launch files or "
        message += "parameters set it"
        yield Finding("sim-time-in-some", others[0].command(), message)


CHECKS = (_unreported, _of_ros2_only, _single, _differing, _releases, _memory, _users, _routers, _times, each(_missing))
