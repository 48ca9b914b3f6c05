"""The steps of a walk: those of bounded worlds (steps.py), and more that people and machines do."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from bounded.steps import DO, Step, put
from bounded.virtual import CALLS
from bounded.walk_robot import WalkRobot
from bounded.walk_worlds import DEVICE, Edits, WalkWorld

from rorg.core.holds import begin_hold
from rorg.core.observed import Container
from rorg.errors import EngineError, RorgError
from rorg.model.catalog import Request
from rorg.model.units import stamp
from rorg.store.requests_document import RequestsDocument

HELD = 4.0
"""Seconds of a hold."""
STARTS = 0.5
"""Seconds from the end of a rorg to the first look of the next one."""
BACK = 4.0
"""Seconds until a device is plugged in again, and an interlock allows again."""
WEIGHTS: Mapping[str, int] = {
    **dict.fromkeys(("request", "release"), 10),
    **dict.fromkeys(("turn", "change", "spoil", "crash"), 5),
    **dict.fromkeys(("revert", "rollback", "reborn", "others", "file", "spoil_file", "undo"), 4),
    **dict.fromkeys(("lease", "urgent", "ask", "replace", "always", "refuse", "killed", "retry", "restart"), 3),
    **dict.fromkeys(("probe", "spoil_ready", "spoil_live"), 3),
    **dict.fromkeys(("hold", "hand_stop", "hand_start", "hand_pause", "hand_remove", "bounce"), 3),
    **dict.fromkeys(("freeze", "skip", "stale", "twice", "outage", "back", "ahead", "unplug", "lock"), 2),
    **dict.fromkeys(CALLS, 2),
    "both": 2,
    "down": 1,
}
"""Verb -> how often it is drawn."""
GLOBAL = ("stale", "twice", "reborn", "killed", "outage", "back", "ahead", "rollback", "revert", "unplug", "down")
PAIRS = ("ask", "replace")
CALM = ("request", "lease", "urgent", "ask", "release", "turn", "others", "replace")
EDITING = (
    "change",
    "spoil",
    "refuse",
    "always",
    "file",
    "spoil_file",
    "probe",
    "spoil_ready",
    "spoil_live",
    "undo",
    "revert",
    "rollback",
    "hold",
)
HARMLESS = ("reborn", "both", "outage", "twice", "stale", "back", "ahead", "lock")
"""Verbs, with those of CALM and EDITING, after which no good change counts as failed."""


def take(world: WalkWorld, robot: WalkRobot, step: Step) -> bool:
    """Do one step. Return False if it is impossible or changes nothing."""
    verb, *of = step
    if any(n >= len(world.names) for n in of):
        return False
    robot.downtimes += verb in ("both", "outage")
    done = DOES[verb](robot, *of) if verb in DOES else DO[verb](robot, *(world.names[n] for n in of))
    robot.disturbed |= (done and verb not in (*CALM, *EDITING, *HARMLESS)) or robot.downtimes > 1
    return bool(done)


# -- edits ---------------------------------------------------------------------------------------------------------


def edit(part: str, value: str, robot: WalkRobot, index: int) -> bool:
    """A person writes a manifest or a file. A `change` is from one good edition to the other."""
    name, edits = robot.world.names[index], robot.edits
    if (part == "files" and name not in robot.world.files) or (part == "probes" and name not in robot.world.probed):
        return False
    old = getattr(edits, part)
    new = value or ("1" if old[index] == "0" else "0")
    return robot.commit(replace(edits, **{part: (*old[:index], new, *old[index + 1 :])}))


def always(robot: WalkRobot, index: int) -> bool:
    now = robot.edits.always
    return robot.commit(replace(robot.edits, always=(*now[:index], not now[index], *now[index + 1 :])))


def undo(robot: WalkRobot, index: int) -> bool:
    """One service is as it was at first, in the file that a person restores."""
    edits, first = robot.edits, robot.world.trees.first()
    parts = {p: (*(old := getattr(edits, p))[:index], getattr(first, p)[index], *old[index + 1 :]) for p in PARTS}
    return robot.commit(replace(edits, **parts))


PARTS = ("editions", "files", "probes")


def revert(robot: WalkRobot) -> bool:
    """The last commit is undone by another one."""
    return len(robot.journal.states) > 1 and robot.commit(robot.journal.states[-2])


def rollback(robot: WalkRobot) -> bool:
    """To the first revision that can be trusted, by a commit."""
    goal = next((one.number for one in robot.journal.earlier() if not one.doubt), None)
    states: dict[int, Edits] = {r.number: s for r, s in robot.journal.revisions()}
    return goal is not None and robot.commit(states[goal])


# -- requests ------------------------------------------------------------------------------------------------------


def urgent(robot: WalkRobot, index: int) -> bool:
    name = robot.world.names[index]
    return put(robot, Request(f"r-{name}", "developer", (name,), priority=90))


def replaced(robot: WalkRobot, index: int, other: int) -> bool:
    """A request is sent again with another list."""
    name = robot.world.names[index]
    known = any(r.key == ("developer", f"r-{name}") for r in robot.document.requests)
    return known and put(robot, Request(f"r-{name}", "developer", (robot.world.names[other],)))


def hold(robot: WalkRobot, index: int) -> bool:
    name = robot.world.names[index]
    made = {**robot.document.holds, name: begin_hold(robot.moment, HELD)}
    robot.document, robot.held[name] = replace(robot.document, holds=made), robot.now + HELD
    return True


def order(kind: str, robot: WalkRobot, index: int) -> bool:
    """A person orders a restart, or another try of a failed change."""
    given = {**getattr(robot.document, kind), robot.world.names[index]: stamp(robot.wall)}
    robot.document = replace(robot.document, **{kind: given})
    return True


# -- rorg ends -----------------------------------------------------------------------------------------------------


def is_call(event: tuple) -> bool:
    """Return whether this is the moment at which the engine has done a call."""
    return getattr(event[2].func, "__name__", "") == "_finish"


def forget_views(robot: WalkRobot) -> None:
    robot.looked, robot.unseen, robot.view = {}, {}, {}


def reborn(robot: WalkRobot) -> bool:
    """Rorg is killed after its calls have reached the engine. The engine has done them by the time at which the next
    rorg has started and looks."""
    late = robot.now + STARTS / 2
    robot._events = [(min(e[0], late) if is_call(e) else e[0], *e[1:]) for e in robot._events]
    robot._events.sort(key=lambda e: e[:2])
    robot.journal.take_over()
    robot.now += STARTS
    robot._happen()
    forget_views(robot)
    return True


def killed(robot: WalkRobot) -> bool:
    """Rorg is killed before its calls have reached the engine."""
    robot._events = [e for e in robot._events if not is_call(e)]
    robot._events.sort(key=lambda e: e[:2])
    return reborn(robot)


def both(robot: WalkRobot, index: int) -> bool:
    """Something kills rorg and a container at the same time, as a lack of memory does."""
    return DO["crash"](robot, robot.world.names[index]) and reborn(robot)


def down(robot: WalkRobot) -> bool:
    """Everything is removed; the journal stays."""
    engine = robot.engine
    robot.document, robot.acknowledged, robot.held = RequestsDocument(), set(), {}
    engine.containers = {id: c for id, c in engine.containers.items() if id in engine.strangers}
    return killed(robot)


# -- behind rorg's back --------------------------------------------------------------------------------------------


def by_hand(verb: str, robot: WalkRobot, index: int) -> bool:
    """Somebody stops, starts, pauses or removes a container. What is impossible does not happen."""
    own = [c for c in robot.engine.containers.values() if c.service == robot.world.names[index]]
    for container in own:
        with contextlib.suppress(RorgError):
            HANDS[verb](robot, container)
            return True
    return False


def hand_start(robot: WalkRobot, container: Container) -> None:
    """Not beside what rorg may be about to start: what a person starts against that is no fault of rorg's."""
    name, active = container.service, robot.active()
    near = {name, *robot.desired.rivals.get(name, ())}
    if near & {*active, *robot.memory.in_flight, *robot.view} or robot.faults.unreachable:
        raise EngineError(f"start {name}", "a person would see that it is in use")
    robot.engine.start(container.id)
    if container.digest in robot.faults.bad or container.service in robot.bad_files:
        run = robot.engine.containers[container.id]
        robot.at(robot.now + 0.5, partial(robot._crash, run.id, run.incarnation))


def hand_remove(robot: WalkRobot, container: Container) -> None:
    del robot.engine.containers[container.id]


HANDS: Mapping[str, Callable[[WalkRobot, Container], None]] = {
    "hand_stop": lambda robot, c: robot.engine.stop(c.id, "SIGTERM", 1.0),
    "hand_start": hand_start,
    "hand_pause": lambda robot, c: robot.engine.pause(c.id),
    "hand_remove": hand_remove,
}


def bounce(robot: WalkRobot, index: int) -> bool:
    """Somebody restarts a good container behind rorg's back."""
    name = robot.world.names[index]
    bad = [c for c in robot.engine.containers.values() if c.service == name and c.digest in robot.faults.bad]
    return not (bad or name in robot.bad_files) and DO["bounce"](robot, name)


def crash(robot: WalkRobot, index: int) -> bool:
    """Its program ends: with an error, or killed."""
    return DO["crash"](robot, robot.world.names[index])


def unplug(robot: WalkRobot) -> bool:
    """A person pulls the plug of the device, and puts it in again, perhaps elsewhere."""
    if not robot.desired.devices:
        return False
    robot.engine.unplug(DEVICE)
    number = f"c 188:{int(robot.now) % 2}"
    robot.at(robot.now + BACK, partial(robot.engine.plug, DEVICE, number=number))
    return True


def lock(robot: WalkRobot, index: int) -> bool:
    """An interlock refuses for a while."""
    name = robot.world.names[index]
    if name in robot.locked or not robot.desired.catalog.services[name].interlock:
        return False
    robot.locked.add(name)
    robot.at(robot.now + BACK, partial(robot.locked.discard, name))
    return True


DOES: Mapping[str, Callable[..., bool]] = {
    "change": partial(edit, "editions", ""),
    "spoil": partial(edit, "editions", "bad"),
    "refuse": partial(edit, "editions", "refused"),
    "file": partial(edit, "files", ""),
    "spoil_file": partial(edit, "files", "bad"),
    "probe": partial(edit, "probes", ""),
    "spoil_ready": partial(edit, "probes", "ready"),
    "spoil_live": partial(edit, "probes", "live"),
    "always": always,
    "undo": undo,
    "revert": revert,
    "rollback": rollback,
    "urgent": urgent,
    "replace": replaced,
    "hold": hold,
    "restart": partial(order, "restarts"),
    "retry": partial(order, "retries"),
    "reborn": reborn,
    "killed": killed,
    "both": both,
    "down": down,
    "bounce": bounce,
    "crash": crash,
    "unplug": unplug,
    "lock": lock,
    **{verb: partial(by_hand, verb) for verb in HANDS},
}
"""Verbs that take numbers of services, unlike those of steps.py, which take names."""
