"""The plan: actions and waitings, each with a reason, and its two forms, text and JSON."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from rorg.core.operations import OPERATIONS, Operation
from rorg.model.codes import BAKING, IMAGE, PARAMETERS


class Part(StrEnum):
    """What several actions of one service do together."""

    NONE = ""
    REPLACE = "replace"
    """Another container takes the place of the current one."""
    RESTART = "restart"
    """The same container begins another run."""


SYMBOLS = {
    **{operation.verb: operation.symbol for operation in OPERATIONS},
    Part.REPLACE: "-/+",
    Part.RESTART: "#/>",
    "wait": ".",
}
"""By what is done, as texts name it."""


@dataclass(frozen=True, slots=True)
class Action:
    """One operation in its place in the plan, with the reason for it. The executor decides nothing."""

    index: int
    """Its place in its service's chain."""
    operation: Operation
    service: str
    reason: str = ""
    fields: tuple[str, ...] = ()
    """Declared options that changed."""
    after: tuple[str, ...] = ()
    """Services whose actions in this plan must have happened, and made them ready, before this one; its own service for
    the action before it in its chain. Only actions without any can be performed now; after each outcome the rest is
    planned anew."""
    urgent: bool = False
    """A live request waits for it."""
    priority: int = 50
    driver: bool = False
    """Of a driver: these go first, since most of a robot waits for its hardware."""
    part_of: Part = Part.NONE
    surplus: bool = False
    """Its container is not the one by which its service is active: a second one, or one that the engine calls dead. It
    is removed although the service is wanted."""

    @property
    def verb(self) -> str:
        """For texts and JSON; decisions look at the operation itself."""
        return self.operation.verb

    @property
    def container(self) -> str:
        return self.operation.container

    def as_json(self) -> dict[str, Any]:
        """For machines, without its place in the plan."""
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
        return f"{self.operation.symbol} {self.verb} {self.service} ({_why(self)})"


@dataclass(frozen=True, slots=True)
class Waiting:
    """Something that would be done, but not now."""

    service: str
    reason: str
    until: float | None = None
    """Time of the loop's clock at which to look again, where that is known."""
    code: str = ""
    """Why it may never be done: failed (it was tried), no-image, device (these cannot be had), blocked (a network or
    volume is not there, or not rorg's), withheld (its removal waits for a person's word), deferred (it is left for
    later), preempted or suspended. Of what only takes its time: image (that is being built or pulled),
    ros-parameters (they are being set), baking (all is done, and it is seen how it does), or empty."""

    @property
    def goes_on(self) -> bool:
        """It will be done if one waits."""
        return self.code in ("", IMAGE, PARAMETERS, BAKING)


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be done and what waits, in the order in which it is to happen."""

    actions: tuple[Action, ...] = ()
    waitings: tuple[Waiting, ...] = ()
    alarm: float | None = None
    """Time of the loop's clock at which something will have to be done though nobody waits for it."""

    @property
    def empty(self) -> bool:
        return not self.actions and not self.waitings

    def text(self) -> str:
        """The canonical text, step by step: what `rorg diff -o wide` prints and planner tests compare."""
        lines: list[str] = []
        named: list[Action | Waiting] = [*self.actions, *self.waitings]
        width = max((len(n.service) for n in named), default=0)
        replaced = ""
        for action in self.actions:
            part = action.part_of is Part.REPLACE
            if part and replaced != action.service:
                lines.append(_line(Part.REPLACE, action.service, width, _why(action)))
            replaced = action.service if part else ""
            reason = ", ".join(filter(None, ["" if part else _why(action), _after(action)]))
            reason = " ".join(filter(None, [reason, _details(action)]))
            lines.append(("    " if part else "") + _line(action.verb, action.service, width, reason))
        lines += [_line("wait", w.service, width, w.reason) for w in self.waitings]
        # A reason may be somebody's text: it makes no line of its own.
        return "".join(line.replace("\n", "\\n").rstrip() + "\n" for line in [*lines, self.summary()])

    def summary(self) -> str:
        """One line with the counts."""
        if self.empty:
            return "No differences."
        replaced = len({a.service for a in self.actions if a.part_of is Part.REPLACE})
        found = Counter(a.verb for a in self.actions if a.part_of is not Part.REPLACE)
        counts = {kind.verb: found[kind.verb] for kind in OPERATIONS}
        parts = [f"{replaced} to replace"] * bool(replaced) + [f"{c} to {n}" for n, c in counts.items() if c]
        parts += [f"{len(self.waitings)} waiting"] * bool(self.waitings)
        return "Plan: " + ", ".join(parts) + "."

    def as_json(self) -> dict[str, Any]:
        """For machines: every action with its reason and order; never the values of the environment."""
        return {
            "actions": [
                {"index": index, "after": after, **a.as_json()} for index, (a, after) in enumerate(self.linked())
            ],
            **self.beside_actions(),
        }

    def beside_actions(self) -> dict[str, Any]:
        """What as_json() says besides."""
        return {
            "waitings": [{"service": w.service, "reason": w.reason, "code": w.code} for w in self.waitings],
            "summary": self.summary(),
        }

    def linked(self) -> list[tuple[Action, list[int]]]:
        """Actions, each with the indices of those that it must follow."""
        last = {a.service: index for index, a in enumerate(self.actions)}
        return [
            (a, [index - 1 if other == a.service else last[other] for other in a.after])
            for index, a in enumerate(self.actions)
        ]


def _line(verb: str, service: str, width: int, reason: str) -> str:
    return f"{SYMBOLS[verb]:<3} {verb:<7} {service:<{width}}  {reason}"


def _why(action: Action) -> str:
    return action.reason + (f": {', '.join(action.fields)}" if action.fields else "")


def _details(action: Action) -> str:
    details = action.operation.details()
    return f"[{'; '.join(details)}]" if details else ""


def _after(action: Action) -> str:
    others = [other for other in action.after if other != action.service]
    return f"after {', '.join(others)}" if others else ""
