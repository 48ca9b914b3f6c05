"""The plan of one service, as the planner keeps it."""

from __future__ import annotations

from dataclasses import dataclass

from rorg.core.plan import Action, Waiting


@dataclass(frozen=True, slots=True, kw_only=True)
class ServicePlan:
    """Of one service, network or volume. `notes` are waitings that hold nothing back; `alarm` is when something will be
    done that is no waiting of anybody's."""

    actions: tuple[Action, ...] = ()
    waitings: tuple[Waiting, ...] = ()
    notes: tuple[Waiting, ...] = ()
    alarm: float | None = None
    unready: str = ""
    """What those that need it wait for; empty when it is ready, or will be by this plan."""
    restless: bool = False
    """It depends on more than itself and its neighbours, such as the time."""

    @property
    def busy(self) -> bool:
        return bool(self.actions or self.waitings or self.notes)


NOTHING = ServicePlan()
