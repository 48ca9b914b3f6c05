"""The alphabet of steps: what people, services, manifests, engines and the world around do to a robot.

Each step is a tuple of its verb and the numbers of the services that it is about. A step that is impossible, or would
change nothing, does not happen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from bounded.virtual import CALLS, WorldRobot
from bounded.worlds import State, World
from robots import handed_on

from rorg.core.requests import problems
from rorg.model.catalog import Request
from rorg.tools.sim.engine import iso

MOST_REQUESTS = 3
LEASE = 2.0
"""Seconds of a lease, in the alphabet."""
UNSEEN = 5.0
"""Seconds until the next full list shows what an event that was lost did not."""
STALE = 1.0
"""Seconds by which a view of all containers is old, and for which each event comes twice."""
OUTAGE = 3.0
CLOCK_SET = 3600.0
"""Seconds by which the machine's clock is set."""
Step = tuple
Robot = tuple[WorldRobot, State]


def alphabet(world: World) -> list[Step]:
    """All steps in a world."""
    count = len(world.names)
    single = ("request", "lease", "release", "turn", "change", "spoil", "always", "crash", "bounce", "freeze", "skip")
    found: list[Step] = [(verb, n) for n in range(count) for verb in (*single, *CALLS)]
    found += [("ask", a, b) for a in range(count) for b in range(count) if a != b]
    found += [("others", n) for n in range(count) if count > 2]
    return [*found, ("stale",), ("twice",), ("reborn",), ("outage",), ("back",), ("ahead",)]


def take(world: World, robot: WorldRobot, state: State, step: Step) -> State | None:
    """Do one step, and return what the manifests say then; None if it is impossible or changes nothing."""
    verb, *of = step
    names = [world.names[n] for n in of]
    if verb in ("change", "spoil", "always"):
        return rewrite(world, robot, state, verb, of[0])
    return state if DO[verb](robot, *names) else None


def rewrite(world: World, robot: WorldRobot, state: State, verb: str, of: int) -> State | None:
    """A person writes a manifest. A tree that rorg refuses changes nothing."""
    if verb == "always":
        now = replace(state, always=tuple(on != (n == of) for n, on in enumerate(state.always)))
    else:
        edition = "bad" if verb == "spoil" else "1" if state.editions[of] == "0" else "0"
        now = replace(state, editions=tuple(edition if n == of else e for n, e in enumerate(state.editions)))
    desired = world.manifests.load(now)
    if now == state or desired is None:
        return None
    robot.desired, robot.faults.bad = desired, world.manifests.bad
    return now


def put(robot: WorldRobot, request: Request) -> bool:
    known = robot.document.requests
    full = len(known) >= MOST_REQUESTS and all(r.key != request.key for r in known)
    if full or request in known or problems(robot.desired.catalog, known, request):
        return False
    robot.document = robot.document.put(request)
    robot.acknowledged.add(request.key)
    return True


def request(robot: WorldRobot, name: str) -> bool:
    return put(robot, Request(f"r-{name}", "developer", (name,)))


def lease(robot: WorldRobot, name: str) -> bool:
    return put(robot, Request(f"r-{name}", "developer", (name,), ttl=LEASE, renewed=""))


def ask(robot: WorldRobot, by: str, name: str) -> bool:
    """A service requests another one, in the run that rorg sees."""
    seen = robot.read.observed.current(by)
    alive = seen is not None and seen.alive and seen.id in robot.engine.containers
    return alive and put(robot, Request(f"a-{name}", by, (name,), incarnation=seen.incarnation))


def release(robot: WorldRobot, name: str) -> bool:
    before = robot.document
    keys = {r.key for r in before.requests if name in r.services}
    robot.document = before.without(keys)
    robot.acknowledged -= keys
    return bool(keys)


def turn(robot: WorldRobot, name: str) -> bool:
    """Everything that was requested is released, and this requested instead, at the same moment."""
    others = [r for r in robot.document.requests if name not in r.services]
    if not others:
        return False
    robot.document = robot.document.without({r.key for r in others})
    robot.acknowledged -= {r.key for r in others}
    request(robot, name)
    return True


def others(robot: WorldRobot, name: str) -> bool:
    """What was requested of one service is released, and all others are requested instead, at the same moment."""
    if not release(robot, name):
        return False
    for other, service in robot.desired.catalog.services.items():
        if other != name and not service.meta:
            request(robot, other)
    return True


def crash(robot: WorldRobot, name: str) -> bool:
    alive = [c for c in robot.engine.containers.values() if c.service == name and c.alive]
    for container in alive:
        robot.engine.kill(container.id)
    return bool(alive)


def bounce(robot: WorldRobot, name: str) -> bool:
    """Somebody restarts its container behind rorg's back."""
    engine = robot.engine
    active = [c for c in engine.containers.values() if c.service == name and c.state == "running"]
    for container in active:
        engine.starts += 1
        engine.containers[container.id] = replace(container, started_at=iso(engine.wall()), start_number=engine.starts)
        engine.calls.append((engine.clock(), "start", name))
    return any(c.digest not in robot.faults.bad for c in active)


def freeze(robot: WorldRobot, name: str) -> bool:
    """Its program does not answer its probe any more, in this run."""
    live = robot.desired.catalog.services[name].live
    runs = {c.incarnation for c in robot.engine.containers.values() if c.service == name and c.state == "running"}
    if not live or runs <= robot.hung:
        return False
    robot.hung |= runs
    return True


def skip(robot: WorldRobot, name: str) -> bool:
    """The next events of a service are lost."""
    robot.unsee(name, UNSEEN)
    return True


def spoil_call(mode: str, robot: WorldRobot, name: str) -> bool:
    """Something becomes of the next call on a service."""
    if robot.spoilt.get(name) == mode:
        return False
    robot.spoilt[name] = mode
    return True


def stale(robot: WorldRobot) -> bool:
    """For a moment, rorg sees everything as it is now."""
    for name in robot.desired.catalog.services:
        if name not in robot.view:
            robot.unsee(name, STALE)
    return True


def twice(robot: WorldRobot) -> bool:
    robot.doubled = robot.now + STALE
    return True


def reborn(robot: WorldRobot) -> bool:
    """Rorg is killed, and begins again with what it wrote."""
    robot.reborn(handed_on(robot.decision))
    robot.looked, robot.unseen, robot.view = {}, {}, {}
    return True


def set_clock(seconds: float, robot: WorldRobot) -> bool:
    """The machine's clock is set."""
    robot.clock_set += seconds
    return True


def outage(robot: WorldRobot) -> bool:
    """The engine restarts: every container of ours ends, and for a moment it answers nothing."""
    if robot.faults.unreachable:
        return False
    for container in [*robot.engine.containers.values()]:
        if container.alive and container.id not in robot.engine.strangers:
            robot.engine.kill(container.id)
    robot.faults.unreachable = True
    robot.at(robot.now + OUTAGE, partial(robot.thaw))
    return True


DO: dict[str, Callable[..., bool]] = {
    "request": request,
    "lease": lease,
    "ask": ask,
    "release": release,
    "turn": turn,
    "others": others,
    "crash": crash,
    "bounce": bounce,
    "freeze": freeze,
    "skip": skip,
    "stale": stale,
    "twice": twice,
    "reborn": reborn,
    "outage": outage,
    "back": partial(set_clock, -CLOCK_SET),
    "ahead": partial(set_clock, CLOCK_SET),
    **{mode: partial(spoil_call, mode) for mode in CALLS},
}
