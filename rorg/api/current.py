"""What operations need to know of how things are: from the running loop's last decision, or from a one-off pass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rorg.core.decide import Decision
from rorg.core.status import Status
from rorg.errors import Busy, Missing, Refused
from rorg.model.catalog import Catalog, Service
from rorg.model.diagnostics import nearest


@dataclass(frozen=True, slots=True)
class Current:
    """How things are, as of one pass."""

    decision: Decision
    statuses: Mapping[str, Status]
    """Of all declared services, and of what is withheld."""
    clock: float
    """Now, in seconds of the clock of the pass, which leases run by."""

    @property
    def catalog(self) -> Catalog:
        """What is declared, and what is withheld with it."""
        return self.decision.situation.desired.catalog

    def members(self, name: str) -> tuple[str, ...]:
        """The services that a name stands for. Raises Missing."""
        found = self.catalog.members(name)
        if not found:
            raise missing(name, {*self.catalog.services, *self.catalog.groups})
        return found

    def containers_of(self, name: str) -> list[Service]:
        """Those of them that have containers. Raises Missing."""
        return [s for n in self.members(name) if not (s := self.catalog.services[n]).meta]

    def runs(self, name: str) -> bool:
        """Whether its container is seen to be alive; a meta-service always is."""
        status = self.statuses.get(name)
        return status is not None and (status.state == "meta" or bool(status.incarnation))

    def incarnation(self, requester: str) -> str | None:
        """The run of the requester that a request belongs to; None for those that have no container. Raises Busy while
        it is not known what runs, and Refused where the requester does not."""
        service = self.catalog.services.get(requester)
        if service is None or service.meta:
            return None
        if not self.decision.situation.observed.complete:
            why = self.decision.situation.observed.error or "the engine has not reported yet what runs"
            raise Busy(f"request as {requester}", why, "again in a moment")
        if not self.runs(requester):
            raise Refused(
                f"request as {requester}",
                f"{requester} does not run, and a request belongs to a run of its requester",
                "requesting it first",
            )
        return self.statuses[requester].incarnation


def missing(name: str, known: set[str]) -> Missing:
    """The error for a name that stands for no service; `known` are those that do."""
    return Missing(f"find the service '{name}'", "no such service", nearest(name, known) or "`rorg get` for all names")
