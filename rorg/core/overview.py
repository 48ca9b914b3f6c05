"""The plan service by service, with what is changed: what `rorg diff` and `rorg apply` show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rorg.core.changed_fields import Change, changed_fields, unified
from rorg.core.diff import Difference, difference
from rorg.core.observed import Container
from rorg.core.operations import Create
from rorg.core.plan import SYMBOLS, Action, Plan
from rorg.core.situation import Situation


@dataclass(frozen=True, slots=True)
class Entry:
    """What is to be done of one service, or why it waits."""

    service: str
    verbs: tuple[str, ...]
    """`replace` and `restart` for the actions that do that together; `wait` where nothing is done."""
    why: str
    changes: tuple[Change, ...] = ()

    def line(self, verbs: int, services: int) -> str:
        """In columns of so many characters."""
        # A reason may be somebody's text: it makes no line of its own.
        why = self.why.replace("\n", "\\n")
        return f"{SYMBOLS[self.verbs[0]]:<3} {self.named:<{verbs}} {self.service:<{services}}  {why}".rstrip()

    @property
    def named(self) -> str:
        return ", ".join(self.verbs)


@dataclass(frozen=True, slots=True)
class Overview:
    """Of a plan in its situation."""

    situation: Situation
    plan: Plan

    def entries(self) -> list[Entry]:
        """One for each service that the plan names, in its order."""
        actions: dict[str, list[Action]] = {}
        waits: dict[str, list[str]] = {}
        for action in self.plan.actions:
            actions.setdefault(action.service, []).append(action)
        for waiting in self.plan.waitings:
            waits.setdefault(waiting.service, []).append(waiting.reason)
        names = dict.fromkeys([*actions, *waits])
        return [self._entry(name, actions.get(name, []), waits.get(name, [])) for name in names]

    def as_json(self) -> list[dict[str, Any]]:
        """With the line for people in each."""
        entries = self.entries()
        verbs = max((len(e.named) for e in entries), default=0)
        verbs = max(verbs, len("replace"))  # as in the text step by step
        services = max((len(e.service) for e in entries), default=0)
        return [
            {
                "service": e.service,
                "verbs": list(e.verbs),
                "why": e.why,
                "changes": [c.as_json() for c in e.changes],
                "line": e.line(verbs, services),
            }
            for e in entries
        ]

    def unified(self) -> dict[str, str]:
        """By service, of those whose container is changed, made or removed: what it was made from against what is
        declared."""
        services = self.situation.desired.catalog.services
        made = {a.service for a in self.plan.actions if isinstance(a.operation, Create)}
        found = {}
        for entry in self.entries():
            service = services.get(entry.service)
            gone = service is None and "remove" in entry.verbs
            if not (entry.changes or entry.service in made or gone):
                continue
            differing = self._differing(entry.service)
            first = next(iter(self.situation.observed.by_service().get(entry.service, ())), None)
            spec, secrets = (service.spec, service.secrets) if service else (None, ())
            text = unified(entry.service, differing[0] if differing else first, spec, secrets)
            if text:
                found[entry.service] = text
        return found

    def _entry(self, name: str, actions: list[Action], waits: list[str]) -> Entry:
        telling, changes = _telling(actions), self._changes(name)
        if actions and not any(_by_change(a, changes) for a in telling):
            changes = ()
        told = "; ".join(map(str, changes))
        reasons = [told if _by_change(a, changes) else _reason(a) for a in telling] if actions else [told]
        after = [other for a in actions for other in a.after if other != name]
        reasons += [f"after {', '.join(dict.fromkeys(after))}"] if after else []
        reasons += [f"waits: {w}" if actions else w for w in waits if w not in reasons]
        why = "; ".join(dict.fromkeys(filter(None, reasons)))
        return Entry(name, tuple(dict.fromkeys(map(_verb, actions))) or ("wait",), why, changes)

    def _changes(self, name: str) -> tuple[Change, ...]:
        differing = self._differing(name)
        if differing is None:
            return ()
        container, found = differing
        service = self.situation.desired.catalog.services[name]
        return changed_fields(container, service.spec or {}, found, service.secrets)

    def _differing(self, name: str) -> tuple[Container, Difference] | None:
        """The container that is to be replaced, else the one that stays, where it is not as it is declared."""
        desired = self.situation.desired
        service = desired.catalog.services.get(name)
        if service is None or service.spec is None:
            return None
        containers = self.situation.observed.by_service().get(name, ())
        found = [(c, difference(c, service.spec, desired.digests[name], desired.declared[name])) for c in containers]
        return next((f for f in found if f[1].recreate), next((f for f in found if f[1].live), None))


def _verb(action: Action) -> str:
    return action.part_of or action.verb


def _telling(actions: list[Action]) -> list[Action]:
    """Those whose reasons are worth telling: the first of what is done together tells why all of it is."""
    parts = [a.part_of for a in actions]
    return [a for index, a in enumerate(actions) if not a.part_of or a.part_of not in parts[:index]]


def _by_change(action: Action, changes: tuple[Change, ...]) -> bool:
    """Whether these changes are why it is done; what is changed may be a file, too."""
    if not changes:
        return False
    fields = {c.field.partition(".")[0] for c in changes} | {c.field for c in changes}
    return action.reason == "changed" and fields.issuperset(action.fields)


def _reason(action: Action) -> str:
    return action.reason + (f": {', '.join(action.fields)}" if action.fields else "")
