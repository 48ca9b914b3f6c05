"""ROS 1: the master, its parameters, and what each service needs from the others."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import combinations

from rorg.manifest.validation.idle import DISCOVERY, INFRASTRUCTURE
from rorg.manifest.validation.robot import Finding, Robot
from rorg.manifest.validation.subject import Subject
from rorg.manifest.validation.texts import names_in, names_of_nodes, ports_named, ports_of, text_of, texts_of
from rorg.model.diagnostics import Where
from rorg.model.joining import SERVICE

CLOCKS = re.compile(r"(?<![\w-])(gazebo|gzserver|stageros|--clock|/clock|webots|ign|gz)\b")
"""Words that identify programs which publish simulated time."""
WAITS = re.compile(r"--wait\b|\bwait[-_]for[-_]")
SIM_TIME = re.compile(r"use_sim_time\W{1,12}(?:value\W{1,3})?true", re.IGNORECASE)


def _masters(robot: Robot) -> Iterator[Finding]:
    for subject in robot.masters[1:]:
        first = robot.masters[0]
        if not robot.apart(first, subject) and _place(first) == _place(subject):
            message = f"'{first.name}' is a ROS master too, at the same address"
            yield Finding("second-master", subject.command(), message, f"conflicts: [{first.name}], or drop one")


def _place(subject: Subject) -> tuple[str, str]:
    own = "" if subject.network == "host" else subject.name
    port = next((w for w, p in zip(subject.words[1:], subject.words, strict=False) if p == "-p"), "11311")
    return own, port


def _needing(robot: Robot) -> Iterator[Finding]:
    """Nodes, and the master with which they register."""
    masters = {s.name: s for s in robot.masters}
    for subject in (s for s in robot.ros1 if masters and not s.is_master):
        mine = [masters[n] for n in sorted(masters) if n in robot.needs(subject.name)]
        names = {m.name for m in mine}
        waits = "roslaunch" not in subject.programs or any(WAITS.search(word) for word in subject.words)
        if not mine:
            first = next(iter(masters))
            known = "has the address of a ROS master" if subject.ros2 else "is a program of ROS 1"
            profile = "" if subject.ros2 else "profile: ros1, or "
            message = f"'{subject.name}' {known}, and does not need '{first}'"
            where = subject.at("needs") if subject.service.needs else subject.source.where("metadata", "name")
            yield Finding("ros1-without-roscore", where, message, f"{profile}needs: [{first}]")
        elif names.isdisjoint(subject.service.restarts_with) and not names.isdisjoint(subject.service.needs):
            message = f"a restarted '{mine[0].name}' knows nothing of '{subject.name}', which keeps running"
            remedy = f"needs: [{{service: {mine[0].name}, restart: true}}], or profile: ros1"
            yield Finding("need-without-restart", _need(subject, mine[0].name), message, remedy)
        if not waits and (not mine or all(m.service.ready is None for m in mine)):
            message = "roslaunch without --wait starts its own master if it finds none"
            yield Finding("roslaunch-without-wait", subject.command(), message)


def _need(subject: Subject, name: str) -> Where:
    for index, need in enumerate(subject.written_list("needs")):
        if need == name or (isinstance(need, dict) and need.get("service") == name):
            return subject.at("needs", index)
    return subject.at("needs")


def _unprobed(robot: Robot) -> Iterator[Finding]:
    """Needed services without `ready` count as ready as soon as their process exists; they answer later."""
    needed = {n for s in robot.subjects for n in s.service.needs}
    # A port that the owner of a joined network publishes may be that of any service in it.
    joined = {robot.whose(s, "network_mode") for s in robot.subjects if s.network.startswith(SERVICE)}
    for subject in robot.subjects:
        if subject.name not in needed or subject.service.ready is not None:
            continue
        what = next((INFRASTRUCTURE[p] for p in sorted(subject.programs) if p in INFRASTRUCTURE), "")
        ports = subject.options.get("ports") or () if subject.name not in joined else ()
        if what or any(not str(port).endswith("/udp") for port in ports):
            who = f"'{subject.name}' is {what}" if what else f"'{subject.name}' has ports that others reach"
            message = f"{who}, and those that need it start before it answers"
            udp = "ready: {log: TEXT}, because a tcp probe cannot ask a port of UDP" if what == DISCOVERY else ""
            yield Finding("needed-without-ready", subject.source.where("metadata", "name"), message, udp)


def _times(robot: Robot) -> Iterator[Finding]:
    """Simulated time without a clock: everything that waits for time waits forever."""
    simulated = [s for s in robot.ros1 if "use_sim_time" in (text := text_of(s)) and SIM_TIME.search(text)]
    if not simulated or any(CLOCKS.search(text_of(s)) for s in robot.subjects):
        return
    for subject in simulated:
        message = f"'{subject.name}' uses simulated time, and no service of this robot publishes it"
        yield Finding("sim-time-without-clock", subject.command(), message)


def _hidden(robot: Robot) -> Iterator[Finding]:
    """Names and ports of other services, in what a service is started with."""
    givers: dict[str, Subject] = {}
    for subject in robot.subjects:
        own = names_of_nodes(subject) if subject.ros1 else frozenset[str]()
        said = {a.probe.target for a in subject.asked_ready if a.probe.kind in ("ros_service", "ros_topic")}
        own = own | {str(name).strip("/").partition("/")[0] for name in said}
        for name in own:
            givers.setdefault(name, subject)
        for port in ports_of(subject):
            givers.setdefault(f":{port}", subject)
    for subject in robot.subjects:
        named = {name for text in texts_of(subject) for name in names_in(text) & givers.keys()}
        named |= {f":{port}" for port in ports_named(subject)} & givers.keys()
        dependencies = {g.name: n for n in sorted(named) if (g := givers[n]) is not subject and not g.is_master}
        asked = robot.asks_for(subject) if dependencies else set()
        own = names_of_nodes(subject) if dependencies and subject.ros1 else frozenset()
        for name, what in sorted(dependencies.items()):
            other = givers[what]
            back = subject.name in robot.needs(name)
            if name in asked or back or what in own or robot.apart(subject, other):
                continue
            shown = f"port {what[1:]}" if what[0] == ":" else f"/{what}"
            message = f"'{subject.name}' uses {shown} of '{name}', which it does not need"
            yield Finding("hidden-dependency", subject.command(), message, f"needs: [{name}]")


def _parameters(robot: Robot) -> Iterator[Finding]:
    """Parameters that two services set: a master has one value per name."""
    declaring = [(s, s.service.ros) for s in robot.subjects if s.service.ros]
    for (one, first), (other, second) in combinations(declaring, 2):
        if robot.apart(one, other) or first.graph != second.graph:
            continue
        before, now = first.values, second.values
        for name in now:
            rival = next((n for n in before if _within(n, name) and (n != name or before[n] != now[name])), "")
            if rival:
                what = "another value" if rival == name else f"its {rival}"
                message = f"'{other.name}' sets {name}, for which '{one.name}' has {what}"
                where = other.at("ros", "parameters", name)
                yield Finding("ros-parameter-twice", where, message, "to declare it in a service that both need")


def _within(one: str, other: str) -> bool:
    """Whether one of two names equals the other or is in its namespace."""
    return f"{one}/".startswith(f"{other}/") or f"{other}/".startswith(f"{one}/")


CHECKS = (_masters, _needing, _unprobed, _times, _hidden, _parameters)
