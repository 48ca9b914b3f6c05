"""The plan: actions and waitings, each with a reason, and its two forms, text and JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rorg.model.codes import BAKING, IMAGE, PARAMETERS

SYMBOLS = {
    "create": "+",
    "update": "~",
    "rename": "~",
    "signal": "~",
    "replace": "-/+",
    "restart": "#/>",
    "start": ">",
    "resume": "=",
    "pause": '"',
    "stop": "#",
    "remove": "-",
    "wait": ".",
}


@dataclass(frozen=True, slots=True)
class Action:
    """One engine call. All that is needed to perform it is here: the executor decides nothing."""

    index: int
    """Its place in its service's chain."""
    verb: str
    """create, update, rename, signal, start, resume, pause, stop or remove."""
    service: str
    container: str = ""
    """Id of the container; empty for one that an earlier action of the plan will create."""
    reason: str = ""
    fields: tuple[str, ...] = ()
    """Declared options that changed."""
    after: tuple[str, ...] = ()
    """Services whose actions in this plan must have happened, and made them ready, before this one; its own service for
    the action before it in its chain. Only actions without any can be performed now; after each outcome the rest is
    planned anew."""
    args: Mapping[str, Any] = field(default_factory=dict)
    """Of a network or volume: object (its kind), name; create: spec, labels.
    create: name, spec, labels. update: options. rename: name. stop: signal, grace (seconds). signal: signal.
    remove: volumes (with them), words (its last ones are worth telling)."""
    urgent: bool = False
    """A live request waits for it."""
    priority: int = 50
    driver: bool = False
    """Of a driver: these go first, since most of a robot waits for its hardware."""
    part_of: str = ""
    """"replace" or "restart" for the actions that do that together."""
    surplus: bool = False
    """Its container is not the one by which its service is active: a second one, or one that the engine calls dead. It
    goes though the service is wanted."""

    def as_json(self) -> dict[str, Any]:
        """For machines, but for its place in the plan."""
        return {
            "verb": self.verb,
            "service": self.service,
            "container": self.container,
            "reason": self.reason,
            "fields": list(self.fields),
            "part_of": self.part_of,
            "urgent": self.urgent,
        }

    def __str__(self) -> str:
        return f"{SYMBOLS[self.verb]} {self.verb} {self.service} ({_why(self)})"


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
            part = action.part_of == "replace"
            if part and replaced != action.service:
                lines.append(_line("replace", action.service, width, _why(action)))
            replaced = action.service if part else ""
            reason = ", ".join(filter(None, ["" if part else _why(action), _after(action)]))
            lines.append(("    " if part else "") + _line(action.verb, action.service, width, reason))
        lines += [_line("wait", w.service, width, w.reason) for w in self.waitings]
        # A reason may be somebody's text: it makes no line of its own.
        return "".join(line.replace("\n", "\\n").rstrip() + "\n" for line in [*lines, self.summary()])

    def summary(self) -> str:
        """One line with the counts."""
        if self.empty:
            return "No differences."
        names = ("create", "update", "rename", "signal", "start", "resume", "pause", "stop", "remove")
        replaced = len({a.service for a in self.actions if a.part_of == "replace"})
        found = Counter(a.verb for a in self.actions if a.part_of != "replace")
        counts = {n: found[n] for n in names}
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


def _after(action: Action) -> str:
    others = [other for other in action.after if other != action.service]
    return f"after {', '.join(others)}" if others else ""
