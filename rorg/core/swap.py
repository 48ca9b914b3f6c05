"""The swap of containers in a rollout: which container of a service is the new one, and which one to go back to if that
does not come up."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from rorg.core.deferred import held_back
from rorg.core.devices import NODES
from rorg.core.memory import STALLED_AFTER
from rorg.core.observed import Container
from rorg.core.operations import Create
from rorg.core.plan import Timed, Waiting
from rorg.core.rollout import came_up_at
from rorg.core.situation import View
from rorg.core.trial import candidate, is_outlived
from rorg.model.catalog import Service
from rorg.model.codes import BAKING
from rorg.model.units import format_seconds


class Swap:
    """The swap of one service. `new` matches its manifest, None if it must be created; `stale` are all other
    containers, and `changed` the options in which they differ."""

    def __init__(
        self,
        view: View,
        service: Service,
        new: Container | None,
        stale: Sequence[Container],
        changed: Collection[str],
    ) -> None:
        self.view, self.service, self.step = view, service, view.s.memory.of(service.name)
        self.update = self.step.update
        self.new: Container | None = None
        """The new container while it is on trial."""
        self.old: Container | None = None
        """The container that is kept to go back to."""
        self.spare: Container | None = None
        """What `old` itself goes back to while that is on trial."""
        tried = self.step.attempt(Create)
        held = new is None and held_back(view, service, changed) is not None
        self.denied = held or (new is None and bool(tried and tried.at and not view.has_come(tried.at)))
        """Whether it cannot or must not be created now."""
        self.failed = ""
        """Why the desired edition is not tried again, in words."""
        if self.update.failed:
            self.failed = f"its change failed ({self.update.failed}); {self._left()}"
        self.lost = False
        """Whether nothing may run: what it would go back to is gone, and what failed is not run again."""
        pair = candidate([c for c in (new, *stale) if c], self.update)
        if pair and (new is None or pair[0] is new) and pair[1] in stale:
            self.new, self.old = new, pair[1]
            if self.denied and not self.failed and pair[0].active:
                self.old, self.spare = pair  # the one on trial runs, and its replacement cannot be created
        # with its device at another node, the old one is useless
        elif new is None and stale and set(changed) != {NODES}:
            self.old = stale[0] if self.worthy(stale[0]) else None
        rejected = self.update.is_rejected(view.desired.digests[service.name])
        if self.old is None and rejected and (new is None or new.id == self.update.rejected):
            self.lost, more = True, f"change it again, or `rorg retry {service.name}`"
            self.failed = f"its change failed ({self.update.failed}), and its previous container is gone; {more}"

    def _left(self) -> str:
        """Return what is left of a service whose change failed, and what to do."""
        if self.step.exits:  # counted since the change failed
            return f"its previous container ended, too; change it again, or `rorg retry {self.service.name}`"
        return f"it stays as it was until it is changed again, or `rorg retry {self.service.name}`"

    @property
    def stays(self) -> bool:
        return self.denied or bool(self.failed)

    @property
    def under_way(self) -> bool:
        """Whether the new container runs on trial."""
        return self.new is not None and self.new.active and self.old is not None and not self.old.alive

    def worthy(self, container: Container) -> bool:
        """Return whether it is worth going back to: it ran and did not end on its own. If no new container can be
        created, any container that ran will do."""
        if not container.started_at or self.step.useless(container):
            return False
        if self.stays:
            return True
        if container.id == self.update.rejected:
            return False
        if container.alive:
            return self.step.exits < STALLED_AFTER
        return self.step.exited != container.incarnation

    def note(self) -> Waiting:
        """Return a note that the trial goes on."""
        step, ready, kept = self.step, self.service.ready, "the previous container is kept until this one"
        if step.well_since is None:
            since, limit, what = step.running_since, ready.timeout if ready else None, "is ready"
            if ready and ready.completed:
                return Waiting(self.service.name, f"{kept} has ended with exit code 0")
            limit = ready.delay if ready and ready.delay is not None else limit
        else:
            since, limit, what = step.well_since, self.service.update.bake, "has been well"
        if since is None or limit is None:
            return Waiting(self.service.name, f"{kept} {what}")
        reason = Timed(f"{kept} {what} (", since, f" of {format_seconds(limit)})")
        up = came_up_at(step, self.service)
        if up is None or not self.view.has_come(up):
            return Waiting(self.service.name, reason, since + limit if up is None else up)
        if not self.view.has_come(since + limit):
            return Waiting(self.service.name, reason, since + limit, BAKING)
        if step.unproven_since is not None:
            return Waiting(self.service.name, f"{kept} is known to be well", code=BAKING)
        return Waiting(
            self.service.name, "the previous container is kept until all services of the set are healthy", code=BAKING
        )


def is_untried(view: View, name: str, container: Container) -> bool:
    """Return whether a container of the desired edition has no way back to the one that stayed well last. It is made
    anew, on trial."""
    update = view.s.memory.of(name).update
    if container.digest != view.desired.digests[name] or container.id == update.well:
        return False
    if is_outlived(container, view.of(name), update):
        return True
    has_way_back = container.previous == update.well
    return (
        bool(container.started_at)
        and not (container.alive or has_way_back)
        and any(c.id == update.well and not c.lost for c in view.of(name))
    )
