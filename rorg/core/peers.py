"""What one machine of a robot knows of the others, as a pass of the loop uses it.

Every machine reads the whole tree, so all of them find the wanted set by the same rule, over the same graph. What only
one of them knows travels: its live requests, and which of its services must not be active. A machine starts and idles
its own services alone.

- A machine whose lease here has ended is *silent*: what its services want is not known, so they want nothing here.
- A service of another machine is *unknown* while that one does not answer. It is not stopped, and nothing is planned
  for it; what needs it waits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rorg.core.desired import Desired
from rorg.core.links import Granted, Link, Remote, Report
from rorg.core.observed import Container
from rorg.model.catalog import Catalog, Request, Service
from rorg.model.objects import keys_of
from rorg.model.units import format_seconds


@dataclass(frozen=True, slots=True)
class Peers:
    """The other machines of the robot, as known at one moment. By default there are none."""

    here: str = ""
    """This machine; "" if the robot has only one."""
    requests: tuple[Request, ...] = ()
    """Live requests of the others; their ids end with @MACHINE."""
    excluded: Mapping[str, str] = field(default_factory=dict)
    """Services that the others keep from being active, each with the reason."""
    silent: frozenset[str] = frozenset()
    """Machines whose lease here is not in force."""
    remotes: Mapping[str, Remote] = field(default_factory=dict)
    """Services of other machines, as far as known."""
    pending: frozenset[str] = frozenset()
    """Machines that have not yet decided with the present requests of this one. What they report may be about to
    change, so nothing is started that relies on it."""
    unknown: Mapping[str, str] = field(default_factory=dict)
    """Their other services -> why nothing is known."""
    unowned: Mapping[str, str] = field(default_factory=dict)
    """Services of this machine that it may not start yet, each with the reason."""
    disputed: Mapping[str, str] = field(default_factory=dict)
    """Services of this machine that another one has too, because it was overruled or has other manifests -> which."""
    said_at: Mapping[str, float] = field(default_factory=dict)
    """Machine -> when the renewal was sent whose content it has certainly taken into account."""
    deadline: float | None = None
    """When the next lease ends."""

    def unready(self, service: Service) -> str:
        """Return why nothing that relies on a service of another machine may be started; "" if it may."""
        if service.away in self.pending:
            return f"is on {service.away}, which is taking up a change"
        return self.trouble(service)

    def trouble(self, service: Service) -> str:
        """Return why a service of another machine is not ready, as far as known; "" if it is."""
        remote = self.remotes.get(service.name)
        if remote is None:
            return self.unknown.get(service.name, silence(service.away, None))
        return "" if remote.ready and remote.wanted else f"is not ready: {remote.reason or 'not wanted'}"

    def shifted(self, seconds: float) -> Peers:
        """Return the same by another clock, which is so many seconds ahead."""
        said_at = {machine: at + seconds for machine, at in self.said_at.items()}
        return replace(self, said_at=said_at, deadline=None if self.deadline is None else self.deadline + seconds)

    def changed(self, before: Peers) -> set[str]:
        """Return services of which something else is known than before."""
        if self is before:
            return set()
        names = {*self.remotes, *self.unknown, *before.remotes, *before.unknown}
        changed = {n for n in names if self._about(n) != before._about(n)}
        changed |= names if self.pending != before.pending else set()
        return changed | {n for n, _ in self.unowned.items() ^ before.unowned.items()}

    def _about(self, name: str) -> tuple[Remote | None, str]:
        return self.remotes.get(name), self.unknown.get(name, "")


NOBODY = Peers()


def peers(
    catalog: Catalog,
    here: str,
    links: Mapping[str, Link],
    granted: Mapping[str, Granted],
    unowned: Mapping[str, str],
    now: float,
) -> Peers:
    """Return what is known at `now`."""
    live = {m: g.renewal for m, g in sorted(granted.items()) if g.live(now) and m in catalog.machines}
    known = {m: report for m, link in links.items() if (report := link.known(now)) is not None}
    remotes, unknown = _elsewhere(catalog, links, known)
    ends = [granted[m].until for m in live] + [at for link in links.values() if (at := link.lost_at) is not None]
    return Peers(
        here,
        tuple(replace(r, id=f"{r.id}@{m}") for m, said in live.items() for r in said.requests if _of(catalog, r, m)),
        {n: f"{why} (on {m})" for m, said in live.items() for n, why in said.excluded.items() if _is_of(catalog, n, m)},
        frozenset(catalog.machines) - {here} - live.keys(),
        remotes,
        frozenset(m for m in known if not links[m].heard(links[m].wants_since)),
        unknown,
        unowned,
        {
            n: m
            for m, report in known.items()
            for n, r in report.services.items()
            if _is_of(catalog, n, here) and r.alive
        },
        {m: links[m].said_at or 0.0 for m in known if links[m].heard(links[m].since)},
        min((at for at in ends if at > now), default=None),
    )


def _elsewhere(
    catalog: Catalog, links: Mapping[str, Link], known: Mapping[str, Report]
) -> tuple[dict[str, Remote], dict[str, str]]:
    """Return services of other machines, as far as known, and the others with the reason."""
    remotes: dict[str, Remote] = {}
    unknown: dict[str, str] = {}
    for name, service in catalog.services.items():
        if not service.away:
            continue
        if service.away not in known:
            unknown[name] = silence(service.away, links.get(service.away))
        elif name in known[service.away].services:
            remotes[name] = known[service.away].services[name]
        else:
            unknown[name] = f"is not in the manifests of {service.away}"
    return remotes, unknown


def _of(catalog: Catalog, request: Request, machine: str) -> bool:
    """Return whether a machine may send this request: it speaks for people and for its own services only."""
    service = catalog.services.get(request.requester)
    return service is not None and (service.meta or service.machine == machine)


def _is_of(catalog: Catalog, name: str, machine: str) -> bool:
    return name in catalog.services and catalog.services[name].machine == machine


def silence(machine: str, link: Link | None) -> str:
    """Return in words why nothing is known of a machine. It does not change while nothing happens, so a plan that says
    it stays the same."""
    if link is None or link.confirmed_at is None:
        return f"is on {machine}, which has not answered yet"
    return f"is on {machine}, which does not answer (lease of {format_seconds(link.duration)})"


def seen_from(catalog: Catalog, here: str) -> Catalog:
    """Return the catalog as one machine uses it: services of other machines have no container, use nothing here and
    do not call this rorg; what they need and request stays."""
    away = {n: s for n, s in catalog.services.items() if s.machine not in ("", here)}
    if not away:
        return catalog
    services = {**catalog.services, **{n: _away(s) for n, s in away.items()}}
    theirs = {key for s in away.values() for key in keys_of(s.options)}
    theirs -= {key for s in services.values() for key in keys_of(s.options)}
    networks = {n: o for n, o in catalog.networks.items() if o.key not in theirs}
    volumes = {n: o for n, o in catalog.volumes.items() if o.key not in theirs}
    return replace(catalog, services=services, networks=networks, volumes=volumes)


def _away(service: Service) -> Service:
    return Service(
        service.name,
        machine=service.machine,
        away=service.machine,
        always_on=service.always_on,
        needs=service.needs,
        protected=service.protected,
        priority=service.priority,
        driver=service.driver,
        description=service.description,
        labels=service.labels,
        where=service.where,
    )


def heard(desired: Desired, silent: frozenset[str]) -> Desired:
    """Return the desired state without what services of silent machines want."""
    catalog = desired.catalog
    quiet = {n for n, s in catalog.services.items() if s.away in silent} if silent else set[str]()
    if not quiet:
        return desired
    services = {n: replace(s, needs=(), always_on=False) if n in quiet else s for n, s in catalog.services.items()}
    requests = tuple(r for r in catalog.requests if r.requester not in quiet)
    return replace(
        desired,
        catalog=replace(catalog, services=services, requests=requests),
        dependants={n: tuple(d for d in names if d not in quiet) for n, names in desired.dependants.items()},
    )


def stand_ins(remotes: Mapping[str, Remote]) -> dict[str, Container]:
    """Return containers that stand for services of other machines, so that their state and run can be looked up like
    those of any other service."""
    containers = {}
    for name, remote in remotes.items():
        run, _, started = remote.incarnation.partition("@")
        if remote.state not in ("none", "unknown"):
            containers[name] = Container(run, name, name, remote.state, started)
    return containers
