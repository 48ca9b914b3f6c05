"""The plan by service, with the changed fields: what `rorg diff` and `rorg apply` show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from rorg.core.changed_fields import Change, Probed, changed_fields, probe_changes, unified
from rorg.core.diff import Difference, difference
from rorg.core.observed import Container
from rorg.core.operations import Create
from rorg.core.plan import SYMBOLS, Action, Plan
from rorg.core.probes_in_force import is_as_proven
from rorg.core.situation import Situation
from rorg.model.causes import verb_before

PROBE = "probe"
"""The verb of a service that goes on as it is, with other probes."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What happens to one service, or why it waits."""

    service: str
    verbs: tuple[str, ...]
    """`replace` and `restart` stand for the actions that make them up; `wait` if nothing is done, and `probe` if only
    the probes change."""
    why: str
    changes: tuple[Change, ...] = ()

    def line(self, verbs: int, services: int) -> str:
        """Return the entry as one line with columns of the given widths."""
        # A reason may quote a program's output; keep it on one line.
        why = self.why.replace("\n", "\\n")
        return f"{SYMBOLS.get(self.verbs[0], '~'):<3} {self.named:<{verbs}} {self.service:<{services}}  {why}".rstrip()

    @property
    def named(self) -> str:
        return ", ".join(self.verbs)


@dataclass(frozen=True)
class Overview:
    """A plan together with its situation. `before` has the probes that are in force: they are no part of a container,
    so no plan shows that they change."""

    situation: Situation
    plan: Plan
    before: Mapping[str, Probed] = field(default_factory=dict)

    @cached_property
    def probes(self) -> dict[str, tuple[Change, ...]]:
        """Return the changes of the probes of each service that has any."""
        services = self.situation.desired.catalog.services
        found = {n: probe_changes(was, services[n]) for n, was in sorted(self.before.items()) if n in services}
        return {name: changes for name, changes in found.items() if changes}

    @property
    def empty(self) -> bool:
        return self.plan.empty and not self.probes

    def text(self) -> str:
        """Return the plan step by step, and then the services of which only the probes change."""
        entries = [e for e in self.entries() if e.service not in self._steps]
        width = max((len(e.service) for e in entries), default=0)
        steps = "" if self.plan.empty else self.plan.text().removesuffix(f"{self.plan.summary()}\n")
        return steps + "".join(f"{e.line(len('replace'), width)}\n" for e in entries) + f"{self.summary()}\n"

    def summary(self) -> str:
        """Return one line with the counts."""
        only = [n for n in self.probes if n not in self._steps]
        failed = sum(bool(self._failed(n)) for n in only)
        counts = [] if self.plan.empty else [self.plan.summary().removeprefix("Plan: ").removesuffix(".")]
        counts += [f"{len(only) - failed} to probe differently"] * (len(only) > failed)
        counts += [f"{failed} with the previous probes"] * bool(failed)
        return f"Plan: {', '.join(counts)}." if only else self.plan.summary()

    def entries(self) -> list[Entry]:
        """Return one entry per service in the plan, in its order, and then one per service of which only the probes
        change."""
        planned = dict(self._steps)
        for name, changes in self.probes.items():
            texts, entry = "; ".join(map(str, changes)), planned.get(name)
            planned[name] = (
                replace(entry, why=f"{entry.why}; {texts}", changes=(*entry.changes, *changes))
                if entry
                else self._probed(name, texts, changes)
            )
        return list(planned.values())

    def _probed(self, name: str, texts: str, changes: tuple[Change, ...]) -> Entry:
        """Return what becomes of a change of probes alone: nothing if it failed."""
        if failed := self._failed(name):
            why = f"{texts}; its change failed ({failed}), so the previous probes stay"
            return Entry(name, ("wait",), why, changes)
        return Entry(name, (PROBE,), f"{texts}; probes only, no restart", changes)

    def _failed(self, name: str) -> str:
        return self.situation.memory.of(name).update.failed

    @property
    def _steps(self) -> dict[str, Entry]:
        """Return the services of which more than the probes changes."""
        return {entry.service: entry for entry in self._planned}

    @cached_property
    def _planned(self) -> list[Entry]:
        actions: dict[str, list[Action]] = {}
        waits = self.plan.reasons()
        for action in self.plan.actions:
            actions.setdefault(action.service, []).append(action)
        names = dict.fromkeys([*actions, *waits])
        return [self._entry(name, actions.get(name, []), waits.get(name, [])) for name in names]

    def as_json(self) -> list[dict[str, Any]]:
        """Return the entries as JSON, each with its line for people."""
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
        """Return, by service, a unified diff from what its container was made from to what is declared, for containers
        that are created, changed or removed."""
        services = self.situation.desired.catalog.services
        made = {a.service for a in self.plan.actions if isinstance(a.operation, Create)}
        texts = {}
        for entry in self._planned:
            service = services.get(entry.service)
            gone = service is None and "remove" in entry.verbs
            if not (entry.changes or entry.service in made or gone):
                continue
            differing = self._differing(entry.service)
            first = self.situation.observed.current(entry.service)
            spec, secrets = (service.spec, service.secrets) if service else (None, ())
            text = unified(entry.service, differing[0] if differing else first, spec, secrets)
            if text:
                texts[entry.service] = text
        return texts

    def _entry(self, name: str, actions: list[Action], waits: list[str]) -> Entry:
        telling, changes = _telling(actions), self._changes(name)
        if actions and not any(_by_change(a, changes) for a in telling):
            changes = ()
        changes_text = "; ".join(map(str, changes))
        reasons = [changes_text if _by_change(a, changes) else a.why for a in telling] if actions else [changes_text]
        after = [other for a in actions for other in a.after if other != name]
        reasons += [f"after {', '.join(dict.fromkeys(after))}"] if after else []
        reasons += [verb_before(w) + w if actions else w for w in waits if w not in reasons]
        why = "; ".join(dict.fromkeys(filter(None, reasons)))
        return Entry(name, tuple(dict.fromkeys(map(_verb, actions))) or ("wait",), why, changes)

    def _changes(self, name: str) -> tuple[Change, ...]:
        differing = self._differing(name)
        if differing is None:
            return ()
        container, difference_found = differing
        service = self.situation.desired.catalog.services[name]
        return changed_fields(container, service.options, difference_found, service.secrets)

    def _differing(self, name: str) -> tuple[Container, Difference] | None:
        """Return the container to be replaced, or else the one that stays and differs from its manifest."""
        desired = self.situation.desired
        service = desired.catalog.services.get(name)
        if service is None or service.spec is None:
            return None
        containers = self.situation.observed.of(name)
        differing = [
            (c, difference(c, service.spec, desired.digests[name], desired.declared[name])) for c in containers
        ]
        return next((f for f in differing if f[1].recreate), next((f for f in differing if f[1].live), None))


def proven_probes(situation: Situation) -> dict[str, Probed]:
    """Return the probes that running containers were proven with, if their manifests have changed since. The declared
    ones are on trial then, or have failed."""
    found: dict[str, Probed] = {}
    for name in situation.desired.editions:
        update = situation.memory.of(name).update
        if update.last_good and is_as_proven(update, situation.observed.current(name)):
            found[name] = update.last_good
    return found


def _verb(action: Action) -> str:
    return action.part_of or action.verb


def _telling(actions: list[Action]) -> list[Action]:
    """Return the actions whose reasons are worth showing: of a replacement or restart, only the first."""
    parts = [a.part_of for a in actions]
    return [a for index, a in enumerate(actions) if not a.part_of or a.part_of not in parts[:index]]


def _by_change(action: Action, changes: tuple[Change, ...]) -> bool:
    """Return whether these changes are the reason for the action; a changed file is another possible reason."""
    if not changes:
        return False
    fields = {c.field.partition(".")[0] for c in changes} | {c.field for c in changes}
    return action.reason == "changed" and fields.issuperset(action.fields)
