"""The state of the robot that operations need: from the running loop's last decision, or from a one-off pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rorg.core.decide import Decision
from rorg.core.status import Status
from rorg.errors import Busy, Missing, Refused
from rorg.model.catalog import Catalog, Service
from rorg.model.diagnostics import Diagnostic, nearest


@dataclass(frozen=True, slots=True)
class Current:
    """The state of the robot as of one pass."""

    decision: Decision
    statuses: Mapping[str, Status]
    """Of all declared services, and of those that are withheld."""
    clock: float
    """The time of the pass, in seconds of its clock, by which leases run."""
    in_git: bool = False
    """The manifests are committed, so that `rorg rollback` can return to earlier ones."""
    errors: Sequence[Diagnostic] = ()
    """Of the manifests, while none are in force."""

    @property
    def catalog(self) -> Catalog:
        """The declared services, including withheld ones."""
        return self.decision.situation.desired.catalog

    def check_in_force(self, what: str) -> None:
        """Raise Refused, with the first mistake of the manifests, if none are in force: without them each name is
        unknown, and none of them is the mistake."""
        if self.errors:
            first, more = self.errors[0], len(self.errors) - 1
            cause, _, _ = first.message.partition("; try ")  # a directory without manifests has a remedy of its own
            why = f"no manifests are in force: {first.where}: {cause}" + (f", and {more} more" if more else "")
            raise Refused(what, " ".join(why.split()), "`rorg validate`, or `rorg run DIR` with another directory")

    def members(self, name: str) -> tuple[str, ...]:
        """The services that a name stands for. Raises Missing, and Refused if no manifests are in force."""
        members = self.catalog.members(name)
        if not members:
            self.check_in_force(f"find the service '{name}'")
            raise missing(name, {*self.catalog.services, *self.catalog.groups})
        return members

    def containers_of(self, name: str) -> list[Service]:
        """Those that have containers, among the services that a name stands for. Raises Missing; and Refused if one
        belongs to another machine."""
        services = [s for n in self.members(name) if not (s := self.catalog.services[n]).meta]
        for service in services:
            if service.away:
                raise elsewhere(name, service)
        return services

    def runs(self, name: str) -> bool:
        """Whether its container is alive, as seen last; a meta-service always is."""
        status = self.statuses.get(name)
        return status is not None and (status.state == "meta" or bool(status.incarnation))

    def incarnation(self, requester: str) -> str | None:
        """The run of the requester to which a request belongs; None if the requester has no container. Raises Busy
        while it is unknown what runs, and Refused if the requester does not run."""
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
                f"`rorg request {requester}` first",
            )
        return self.statuses[requester].incarnation


def elsewhere(what: str, service: Service, remedy: str = "the same command on {machine}") -> Refused:
    """The error for what only a service's own machine can do."""
    why = f"{service.name} belongs to the machine {service.away}"
    return Refused(f"reach {what}", why, remedy.format(machine=service.away))


def missing(name: str, known: set[str]) -> Missing:
    """The error for a name that stands for no service; `known` are those that do."""
    return Missing(f"find the service '{name}'", "no such service", nearest(name, known) or "`rorg get` for all names")
