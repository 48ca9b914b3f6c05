"""The plan: actions and waitings, each with a reason. It has two forms, text for people and JSON for programs."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from enum import StrEnum
from math import ceil, inf
from typing import Any

from rorg.core.operations import OPERATIONS, Create, Operation, Rename, Stop
from rorg.model.codes import BAKING, IMAGE, PARAMETERS
from rorg.model.units import format_seconds


class Part(StrEnum):
    """A group of actions of one service that belong together."""

    NONE = ""
    REPLACE = "replace"
    """A new container takes the place of the current one."""
    RESTART = "restart"
    """The same container begins another run."""


SYMBOLS = {
    **{operation.verb: operation.symbol for operation in OPERATIONS},
    Part.REPLACE: "-/+",
    Part.RESTART: "#/>",
    "wait": ".",
}
"""Symbols in the text of a plan, by verb or part."""


@dataclass(frozen=True, slots=True)
class Action:
    """One operation in its place in the plan, with its reason. The worker that executes it decides nothing."""

    index: int
    """Its place in its service's chain."""
    operation: Operation
    service: str
    reason: str = ""
    fields: tuple[str, ...] = ()
    """Declared options that changed."""
    after: tuple[str, ...] = ()
    """Services whose actions in this plan must come first and make them ready. Its own service stands for the action
    before it in its chain. Only an action that follows nothing can begin now; after each outcome the rest is planned
    again."""
    urgent: bool = False
    """A live request waits for it."""
    priority: int = 50
    driver: bool = False
    """The service is a driver. Drivers go first, because most of a robot waits for its hardware."""
    part_of: Part = Part.NONE
    surplus: bool = False
    """Its container is not the service's current one: a second container, or one the engine calls dead. It is removed
    although the service is wanted."""

    @property
    def verb(self) -> str:
        """For texts and JSON; decisions look at the operation itself."""
        return self.operation.verb

    @property
    def runs(self) -> bool:
        """Whether the program runs because of it, even if only to end."""
        return self.operation.begins or (isinstance(self.operation, Stop) and self.operation.resumes)

    @property
    def asks_to_end(self) -> bool:
        """Whether it sends a signal to the program, which must run to receive it."""
        return isinstance(self.operation, Stop) and self.operation.signal != "SIGKILL"

    def ends_run(self, run: str) -> bool:
        """Return whether a run does not survive this action. A replacement ends it with its first call, because nothing
        else is planned while a call is under way."""
        if self.part_of is Part.REPLACE and isinstance(self.operation, (Create, Rename)):
            return True
        return self.operation.ends and self.container[:12] == run.partition("@")[0]

    @property
    def why(self) -> str:
        """The reason, with the changed options if there are any."""
        return self.reason + (f": {', '.join(self.fields)}" if self.fields else "")

    @property
    def container(self) -> str:
        return self.operation.container

    def as_json(self) -> dict[str, Any]:
        """Return it for machines, without its place in the plan."""
        return {
            "verb": self.verb,
            "service": self.service,
            "container": self.container,
            "reason": self.reason,
            "fields": list(self.fields),
            "part_of": self.part_of.value,
            "urgent": self.urgent,
        }

    def __str__(self) -> str:
        return f"{self.operation.symbol} {self.verb} {self.service} ({self.why})"


@dataclass(frozen=True, slots=True)
class Timed:
    """A text that shows the seconds until a moment, or since it: `again in 8 s`, `is not ready (3 s of 30 s)`.

    It holds the moment, by the loop's clock, and not the seconds. So it is equal from pass to pass, and a plan that
    contains it need not be made again because time goes by.
    """

    before: str
    moment: float
    after: str = ""
    due: str = ""
    """What to say instead once the moment has come; empty to go on counting."""

    def at(self, now: float) -> str:
        """Return the text as of now. A countdown shows whole seconds, and ends with 1 s."""
        left = self.moment - now
        if left <= 0 and self.due:
            return self.due
        seconds = max(1.0, float(ceil(left - 1e-6))) if left > 0 else now - self.moment
        return f"{self.before}{format_seconds(seconds)}{self.after}"


Reason = str | Timed
"""Why something waits."""


def prefixed(prefix: str, reason: Reason) -> Reason:
    """Return a reason with words in front of it."""
    if isinstance(reason, str):
        return prefix + reason
    return replace(reason, before=prefix + reason.before, due=reason.due and prefix + reason.due)


def printed(reason: Reason, now: float) -> str:
    """Return the text of a reason as of now."""
    return reason if isinstance(reason, str) else reason.at(now)


@dataclass(frozen=True, slots=True)
class Waiting:
    """Something that cannot be done yet."""

    service: str
    reason: Reason
    until: float | None = None
    """When to look again, by the loop's clock, if that is known."""
    code: str = ""
    """Why it waits.

    Codes of waitings that may never end:

    - failed: it was tried;
    - no-image, device: it cannot be obtained;
    - blocked: a network or volume is missing or not rorg's;
    - withheld: its removal needs a person's confirmation;
    - deferred: it is left for later;
    - room: a service that excludes it runs;
    - removal: the engine does not remove a container that is over, which nothing depends on;
    - preempted, suspended.

    Codes of waitings that only take time:

    - image: it is being built or pulled;
    - ros-parameters: they are being set;
    - baking: everything is done, and the new container must stay well for a while;
    - empty: anything else.
    """

    @property
    def goes_on(self) -> bool:
        """Whether it will be done without anyone's help."""
        return self.code in ("", IMAGE, PARAMETERS, BAKING)


@dataclass(frozen=True, slots=True)
class Plan:
    """Actions and waitings, in order. Its texts show seconds as of `now`, by the loop's clock."""

    actions: tuple[Action, ...] = ()
    waitings: tuple[Waiting, ...] = ()
    now: float = 0.0

    @property
    def empty(self) -> bool:
        return not self.actions and not self.waitings

    def reasons(self, *codes: str) -> dict[str, list[str]]:
        """Return why each service waits, in order; with codes, only for these."""
        reasons: dict[str, list[str]] = {}
        for waiting in self.waitings:
            if not codes or waiting.code in codes:
                reasons.setdefault(waiting.service, []).append(printed(waiting.reason, self.now))
        return reasons

    def text(self) -> str:
        """Return the canonical text, step by step: what `rorg diff -o wide` prints and planner tests compare."""
        lines: list[str] = []
        named: list[Action | Waiting] = [*self.actions, *self.waitings]
        width = max((len(n.service) for n in named), default=0), max([7, *(len(a.verb) for a in self.actions)])
        replaced = ""
        for action in self.actions:
            part = action.part_of is Part.REPLACE
            if part and replaced != action.service:
                lines.append(_line(Part.REPLACE, action.service, width, action.why))
            replaced = action.service if part else ""
            reason = ", ".join(filter(None, ["" if part else action.why, _after(action)]))
            reason = " ".join(filter(None, [reason, _details(action)]))
            lines.append(("    " if part else "") + _line(action.verb, action.service, width, reason))
        lines += [_line("wait", w.service, width, printed(w.reason, self.now)) for w in self.waitings]
        # A reason may quote a program's output; keep it on one line.
        return "".join(line.replace("\n", "\\n").rstrip() + "\n" for line in [*lines, self.summary()])

    def summary(self) -> str:
        """Return one line with the counts."""
        if self.empty:
            return "No differences."
        replaced = len({a.service for a in self.actions if a.part_of is Part.REPLACE})
        count_of = Counter(a.verb for a in self.actions if a.part_of is not Part.REPLACE)
        counts = {kind.verb: count_of[kind.verb] for kind in OPERATIONS}
        parts = [f"{replaced} to replace"] * bool(replaced) + [f"{c} to {n}" for n, c in counts.items() if c]
        parts += [f"{len(self.waitings)} waiting"] * bool(self.waitings)
        return "Plan: " + ", ".join(parts) + "."

    def as_json(self) -> dict[str, Any]:
        """Return it for machines: every action with its reason and order, never values of the environment."""
        return {
            "actions": [
                {"index": index, "after": after, **a.as_json()} for index, (a, after) in enumerate(self.linked())
            ],
            **self.beside_actions(),
        }

    def beside_actions(self) -> dict[str, Any]:
        """Return the part of as_json() besides actions."""
        return {
            "waitings": [
                {"service": w.service, "reason": printed(w.reason, self.now), "code": w.code} for w in self.waitings
            ],
            "summary": self.summary(),
        }

    def linked(self) -> list[tuple[Action, list[int]]]:
        """Return the actions, each with the indices of those it follows."""
        last = {a.service: index for index, a in enumerate(self.actions)}
        return [
            (a, [index - 1 if other == a.service else last[other] for other in a.after])
            for index, a in enumerate(self.actions)
        ]


def _line(verb: str, service: str, width: tuple[int, int], reason: str) -> str:
    """Return a line of a plan; `width` are the widest service and verb."""
    return f"{SYMBOLS[verb]:<3} {verb:<{width[1]}} {service:<{width[0]}}  {reason}"


def _details(action: Action) -> str:
    details = action.operation.details()
    return f"[{'; '.join(details)}]" if details else ""


def _after(action: Action) -> str:
    others = [other for other in action.after if other != action.service]
    return f"after {', '.join(others)}" if others else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServicePlan:
    """The plan of one service, network or volume. `notes` are waitings that hold nothing back; `alarm` is when
    something is due that no waiting mentions."""

    actions: tuple[Action, ...] = ()
    waitings: tuple[Waiting, ...] = ()
    notes: tuple[Waiting, ...] = ()
    alarm: float | None = None
    unready: Reason = ""
    """What services that need this one wait for; "" if it is ready or will be by this plan."""
    volatile: bool = False
    """The plan depends on every moment or on unrelated services, so it is made again in every pass."""
    until: float = inf
    """Otherwise it changes with the time only from then on."""

    @property
    def busy(self) -> bool:
        return bool(self.actions or self.waitings or self.notes)

    @property
    def runs(self) -> bool:
        """Whether the service begins to run, or is resumed to end."""
        return any(action.runs for action in self.actions)


NOTHING = ServicePlan()
