"""Reconciliation: the chain of engine calls that leads a service from what is observed to what is desired. The gates
(gates.py) decide afterwards how much of it may happen now."""

from __future__ import annotations

from dataclasses import replace

from rorg.core.deferred import left_over
from rorg.core.devices import NODES, given, nodes_of, replugged
from rorg.core.diff import REPLICAS, Difference, declared_anew, difference
from rorg.core.digest import Rules, labels
from rorg.core.idle import cease
from rorg.core.joining import can_return, is_made_ahead, missing, moved, with_ids
from rorg.core.observed import Container
from rorg.core.operations import Create, Remove, Rename, Start
from rorg.core.plan import Part, Waiting
from rorg.core.situation import View
from rorg.core.steps import (
    Chain,
    Step,
    adjust,
    awaken,
    away,
    cannot_go_on,
    free_name,
    make_room,
    restarting,
    stop,
    stops,
)
from rorg.core.swap import Swap, is_untried
from rorg.model.catalog import Service, Spec
from rorg.model.codes import DEVICE, FAILED


def chain(view: View, service: Service) -> Chain:
    """Return the chain of a service."""
    reconciled = _Reconciled(view, service)
    steps = reconciled.steps()
    return Chain(steps, reconciled.notes, reconciled.alarm)


class _Reconciled:
    def __init__(self, view: View, service: Service) -> None:
        self.view, self.service = view, service
        self.s, self.desired, self.name = view.s, view.desired, service.name
        self.step = view.s.memory.of(service.name)
        self.nodes = nodes_of(service, view.s.devices)
        self.moved = {c.id: other for c in view.of(service.name) if (other := moved(view, service, c))}
        """Container id -> a joined service that has another container now."""
        self.notes: list[Waiting] = []
        self.alarm: float | None = None

    def steps(self) -> list[Step]:
        """Return all steps of a service, from what is observed to what is desired."""
        name, spec = self.name, self.service.options
        pairs = [(c, self.difference(c, spec)) for c in self.view.of(name)]
        usable = [(c, d) for c, d in pairs if not (self.step.useless(c) or is_untried(self.view, name, c))]
        current = next(((c, d) for c, d in usable if not d.recreate and c.id not in self.moved), None)
        stale = [(c, d) for c, d in pairs if current is None or c is not current[0]]
        swap = Swap(self.view, self.service, current and current[0], self.worth(stale), self.changed(stale))
        if swap.stays and (swap.old or swap.lost):
            return self.stay(swap, current, stale)
        if not (name in self.s.wanted or self.keeps(current is not None)):
            return self.clear(pairs, False)
        if swap.old and (why := self.must_restart(swap.old)):
            ended = [stop(swap.old, why, self.service)]
            return restarting(swap.old, [*ended, *self.run(swap.old, ended)])
        if current is None and self.not_to_be_made():
            return [*self.clear(stale[1:], True), *self.cease(stale[0][0])] if stale else []
        steps: list[Step] = []
        new_name = ""
        if current is None:
            new_name = free_name(self.view, self.service, [c for c, _ in stale])
            steps.append(self.create(new_name, stale, swap.old))
        others = self.clear([p for p in stale if not (p[0] is swap.old or self.rolls_over(p[0], current))], True)
        # The trial goes on beside these removals, so they are not part of a replacement.
        steps += [replace(step, surplus=True) for step in others] if swap.under_way else others
        if swap.old:
            steps += make_room(self.view, self.service, swap.old)
        if current:
            steps += adjust(self.view, self.service, *current)
            self.notes += left_over(self.view, self.service, current[0])
        elif new_name != self.service.container_name and self.s.engine.rename:
            steps.append(Step(Rename(name=self.service.container_name), "it takes over the name"))
        if swap.old and swap.old.alive and not self.rolls_over(swap.old, None):
            steps.append(stop(swap.old, "changed", self.service))
        steps += self.run(current and current[0], steps, self.desired.editions[name] if swap.old else "")
        if swap.under_way:
            self.notes += [swap.note()] if name in self.s.wanted else []
        elif swap.old or any((d.recreate or c.id in self.moved) and (c, d) in usable for c, d in stale):
            return [replace(s, part_of=Part.REPLACE) for s in steps]
        return restarting(current and current[0], steps)

    def difference(self, container: Container, spec: Spec) -> Difference:
        """Add differences that no option shows: a stopped container cannot start on a network that was recreated, even
        under the same name; and a container's device may be at another node now."""
        declared = difference(container, spec, self.desired.digests[self.name], self.desired.declared[self.name])
        nodes = (NODES,) if not declared.recreate and replugged(container, self.nodes) else ()
        networks = ("networks",) if self.on_another(container) else ()
        more = (*nodes, *networks, *self.not_in_place(container, declared))
        live = {k: v for k, v in declared.live.items() if self.s.engine.update or k == REPLICAS}
        return replace(declared, recreate=(*declared.recreate, *more), live=live) if more or not live else declared

    def not_in_place(self, container: Container, declared: Difference) -> tuple[str, ...]:
        """Return options that an engine with `rename` and `update` would change in place. A name that was only made
        unique is no difference. Nor is a value that the engine ignored when it made the container, such as a limit of
        rootless Podman: the next container would have it no more than this one."""
        own, engine = self.service.container_name, self.s.engine
        named = engine.rename or container.name == own or container.name.startswith(f"{own}.")
        changed = declared_anew(container, declared.live, self.desired.declared[self.name])
        return (*(() if named else ("container_name",)), *(() if engine.update else changed))

    def on_another(self, container: Container) -> bool:
        """Return whether a stopped container was joined to a network that is gone or about to be replaced."""
        if container.alive or (objects := self.s.observed.objects) is None:
            return False
        for name in self.desired.uses.get(self.name, ()):
            network = self.desired.objects[name]
            joined = container.networks.get(network.called, "") if network.kind == "network" else ""
            existing = objects.found.get(network.key)
            gone = network.key in objects.asked if existing is None else existing.id != joined
            if joined and (gone or self.view.has_actions(name)):
                return True
        return False

    def stay(
        self,
        swap: Swap,
        current: tuple[Container, Difference] | None,
        stale: list[tuple[Container, Difference]],
    ) -> list[Step]:
        """Return the steps that keep or restore the previous container, unless it is lost: the new one cannot be
        created or did not come up."""
        old, new = swap.old, current and current[0]
        if swap.failed:
            self.notes.append(Waiting(self.name, swap.failed, code=FAILED))
        if not (self.name in self.s.wanted or self.keeps(True)):
            return self.clear([p for p in (*stale, current) if p], False)
        goal = "back to the previous container" if old else "its change failed"
        why = f"{goal}: {swap.update.failed}" if swap.failed else "changed"
        others = [c for c, _ in stale if c is not old] + ([] if new is None else [new])
        if old is None:
            return [replace(s, part_of=Part.REPLACE) for c in others for s in away(c, why, self.service)]
        steps = [stop(c, why, self.service) for c in others if c.alive]
        steps += [
            s
            for s in adjust(self.view, self.service, old, Difference())
            if not others or not isinstance(s.operation, Rename)
        ]
        steps += self.run(old, steps)
        left = [c for c in others if c is not swap.spare]
        steps += [Step(Remove(container=c.id, last_words=c is new), why) for c in left if c.state != "removing"]
        if left:
            return [replace(s, part_of=Part.REPLACE, reason=why) for s in steps]
        steps = restarting(old, steps)
        return steps if swap.failed else [*steps, self.create(free_name(self.view, self.service, [old]), stale, old)]

    def must_restart(self, old: Container) -> str:
        """Return why the current run ends and begins again while its change waits for its set: no new container of the
        set takes its place before all of them exist. "" if the run goes on."""
        waits = self.step.update.held and self.name in self.s.wanted and old.id not in self.moved
        if not waits or not old.alive or self.name in self.s.restarts:
            return ""
        return cannot_go_on(self.view, self.service, old)

    def worth(self, stale: list[tuple[Container, Difference]]) -> list[Container]:
        """Return the containers that are worth going back to. A container that is only joined to old containers is no
        different from the new one, and one that cannot start is useless."""
        return [
            c
            for c, diff in stale
            if (diff.recreate or c.id not in self.moved)
            and can_return(self.view, self.service, c)
            and not (self.on_another(c) or self.step.useless(c) or is_untried(self.view, self.name, c))
        ]

    def changed(self, stale: list[tuple[Container, Difference]]) -> tuple[str, ...]:
        """Return the options in which containers differ and whose change may wait. A run whose joined namespace has
        ended is replaced in any case."""
        if any(c.id in self.moved and c.alive for c, _ in stale):
            return ()
        return tuple(sorted({field for _, difference in stale for field in difference.recreate}))

    def not_to_be_made(self) -> bool:
        """Return whether creation can wait: the service is unwanted, and its device or a container to join is
        missing."""
        other = missing(self.view, self.service)
        if self.name in self.s.wanted or not (other or self.name in self.s.unplugged):
            return False
        if not other:
            return True
        if other in self.s.wanted or is_made_ahead(self.view, other):
            self.notes.append(Waiting(self.name, f"waits for a container of {other}"))
        return True

    def run(self, container: Container | None, steps: list[Step], trial: str = "") -> list[Step]:
        """Return the steps that activate or cease it. `trial` is the edition that a start tries."""
        if self.name in self.s.wanted:
            return self.wake(container, steps, trial)
        return self.cease(container) if container else []

    def rolls_over(self, old: Container, new: tuple[Container, Difference] | None) -> bool:
        """Return whether the start of the new container, which is yet to come, ends the old one's run."""
        return old.alive and self.s.engine.rolls and self.name in self.s.wanted and not (new and new[0].active)

    def keeps(self, has_one: bool) -> bool:
        """Return whether it has a container while unwanted. A container removed at the end of idling is not created
        again."""
        ends_removed = self.service.idle.escalate is not None and self.service.idle.escalate[1] == "remove"
        return self.service.idle.action != "remove" and (has_one or not ends_removed)

    def create(self, name: str, stale: list[tuple[Container, Difference]], old: Container | None) -> Step:
        """Return the step that creates a container. `old` is kept in case the new one does not come up."""
        declared, made_from = self.service.options, self.desired.digests[self.name]
        spec, joined = with_ids(self.view, self.service)
        marks = labels(
            self.s.owner,
            self.name,
            declared,
            made_from,
            self.rules(),
            previous=old.id if old else "",
            secrets=self.service.secrets,
            joined=joined,
            devices=self.nodes,
        )
        before = old or next((c for c, _ in stale), None)
        made = Create(
            name=name,
            spec=given(spec, self.service, self.s.devices),
            labels=marks,
            digest=made_from,
            before=before.id if before else "",
            defaults=self.service.defaults,
        )
        return Step(made, self.why_stale(stale) if stale else "no container", self.changed(stale))

    def why_stale(self, stale: list[tuple[Container, Difference]]) -> str:
        if all(self.step.useless(c) and not diff.recreate for c, diff in stale):
            return self.step.useless(stale[0][0])
        others = [self.moved[c.id] for c, diff in stale if c.id in self.moved and not diff.recreate]
        return f"{others[0]} has another container" if len(others) == len(stale) else "changed"

    def rules(self) -> Rules:
        return Rules(self.service.interlock, self.service.exclusive, self.desired.conflicts[self.name])

    def clear(self, stale: list[tuple[Container, Difference]], keep: bool) -> list[Step]:
        """Return the steps that remove containers other than the service's current one."""
        steps: list[Step] = []
        for container, diff in stale:
            useless, another = bool(self.step.useless(container)), diff.recreate or container.id in self.moved
            reason = self.why_stale([(container, diff)]) if useless or another else "a second container of this service"
            way = away(container, reason if keep else "not wanted", self.service, volumes=not keep)
            surplus = keep and (useless or not another or is_untried(self.view, self.name, container))
            steps += [replace(step, surplus=surplus) for step in way]
        return steps

    def wake(self, container: Container | None, steps: list[Step], trial: str) -> list[Step]:
        if container and (other := self.moved.get(container.id)):
            self.notes.append(Waiting(self.name, f"{other} has another container than the one that it is joined to"))
            return []
        why = str(self.s.wanted[self.name][0])
        runs = {
            n: need_container.incarnation
            for n in self.service.restarts_with
            if (need_container := self.view.current(n)) and need_container.started_at
        }
        read = self.desired.contents.get(self.name)
        start = Start(
            container=container.id if container else "",
            trial=trial,
            counts_on=runs,
            content=None if read is None else dict(read),
        )
        if container is None or stops(container, steps):
            return [Step(start, why)]
        if container.asleep:
            return awaken(self.service, container, why)
        if container.active:
            return self.without_device(container)
        if self.step.over(self.service, container) and self.s.restarts.get(self.name) != container.incarnation:
            return []
        if container.state == "exited" and self.step.exited == container.incarnation and self.step.error:
            why += f"; {self.step.error}"
        return [Step(start, why)]

    def without_device(self, container: Container) -> list[Step]:
        """Return the steps for a running service whose device is gone."""
        why = self.s.unplugged.get(self.name, "")
        if not why or self.service.unplugged == "keep":
            return []
        self.notes.append(Waiting(self.name, why, code=DEVICE))
        return [stop(container, why, self.service)]

    def cease(self, container: Container) -> list[Step]:
        steps, alarm = cease(self.view, self.service, container)
        self.alarm = self.alarm if alarm is None else alarm
        return steps
