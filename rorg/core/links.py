"""Leases between the machines of one robot, as values: what machines tell each other, and how long that counts.

Each machine sends a *renewal* to every other one, again and again: all its live requests, so that a lost or repeated
message does no harm. While the renewal counts at the other machine, what these requests want is active there. The two
sides count the same lease by their own clocks, and neither compares times of day:

- the other machine (`Granted`) counts from when it received the newest renewal;
- the sender (`Link`) counts from when it sent the newest renewal that was answered, and stops MARGIN earlier. So its
  programs learn that a service is lost before the other machine may let go of it.

A renewal carries (incarnation, number). Incarnations of rorg on a machine only grow, so a message that comes late from
an earlier one is recognized and refused (a fencing token).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from rorg.model.catalog import Request

MARGIN = 0.1
"""Part of a lease by which the sender stops relying on it earlier. It covers clocks that differ by 5 %, and the time
until a pass of the loop has told programs."""
RENEWALS = 3
"""Renewals per lease: one may be lost without any effect, and two if the answers are quick."""
MOST_UNANSWERED = 64
"""Renewals under way that are remembered; an answer to an older one does not extend the lease."""
Stamp = tuple[int, int]
"""(incarnation, number) of a renewal, or (incarnation, version) of a report."""


class Content(NamedTuple):
    """What a renewal says, apart from who sends it and when; the fields are those of Renewal."""

    requests: tuple[Request, ...] = ()
    excluded: Mapping[str, str] = {}
    asking: tuple[tuple[str, float], ...] = ()
    takes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Renewal:
    """Everything that one machine asks of another, in full."""

    machine: str
    boot: str
    """Id of the boot of its kernel, for people."""
    incarnation: int
    """Which rorg of that machine; a later one has a higher number."""
    number: int
    since: int
    """Number of the first renewal that said the same: a report that takes it into account is due."""
    duration: float
    """Seconds for which it counts."""
    requests: tuple[Request, ...] = ()
    """All its live requests."""
    excluded: Mapping[str, str] = field(default_factory=dict)
    """Its own services that must not be active now, each with the reason."""
    asking: tuple[tuple[str, float], ...] = ()
    """(service, since when a caller there waits for it, by the sender's clock): its probe is asked again."""
    takes: tuple[str, ...] = ()
    """Services that its manifests give to it, and that it may not start until the receiver has confirmed that they have
    ended there."""

    @property
    def stamp(self) -> Stamp:
        return self.incarnation, self.number

    @property
    def changed(self) -> Stamp:
        """The stamp of the first renewal that said the same."""
        return self.incarnation, self.since

    @property
    def content(self) -> Content:
        return Content(self.requests, self.excluded, self.asking, self.takes)

    @property
    def wants(self) -> tuple[object, ...]:
        """The part that decides which services must be active."""
        return self.requests, self.excluded


@dataclass(frozen=True, slots=True)
class Remote:
    """A service as its own machine reports it."""

    state: str
    """The engine's word, or `none`."""
    wanted: bool
    ready: bool
    health: str
    sync: str
    incarnation: str = ""
    reason: str = ""
    """Why it is not ready."""

    @property
    def alive(self) -> bool:
        """Whether a run of it goes on."""
        return bool(self.incarnation)


@dataclass(frozen=True, slots=True)
class Report:
    """How the services of one machine are."""

    incarnation: int
    version: int
    heard: Stamp
    """The newest renewal of the receiver that this takes into account."""
    services: Mapping[str, Remote] = field(default_factory=dict)

    @property
    def stamp(self) -> Stamp:
        return self.incarnation, self.version


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a renewal."""

    incarnation: int
    """Of the machine that answers."""
    newest: Stamp
    """The newest renewal that it has."""
    released: tuple[str, ...] = ()
    """Services in `takes` that do not run there and that its manifests give to another machine."""
    kept: Mapping[str, str] = field(default_factory=dict)
    """The other services in `takes`, each with the reason."""
    report: Report | None = None
    """How its services are. So a report is never older than the lease that it is trusted for."""


@dataclass(frozen=True, slots=True)
class Granted:
    """The newest renewal of another machine, and when it was received (by the receiver's monotonic clock)."""

    renewal: Renewal
    received: float

    @property
    def until(self) -> float:
        return self.received + self.renewal.duration

    def live(self, now: float) -> bool:
        return now < self.until


def grant(last: Granted | None, renewal: Renewal, now: float) -> Granted | None:
    """Return the lease after a renewal; None if the renewal is refused because a later one, or the same, is known."""
    if last is not None and renewal.stamp <= last.renewal.stamp:
        return None
    return Granted(renewal, now)


def resumed(granted: Granted, now: float) -> Granted:
    """Return a lease that was written to disk, after a restart: it counts for its full time again, so a restart takes
    nothing away from a machine that still renews it."""
    return replace(granted, received=now)


@dataclass(frozen=True, slots=True)
class Link:
    """The sender's side of a lease. Times are of its own monotonic clock, in seconds."""

    duration: float
    own: int = 0
    """Incarnation of the rorg on this machine, as the other one is told. It is higher than the one counted here if the
    other machine knows a later one."""
    number: int = 0
    """Of the last renewal sent."""
    sent_at: float | None = None
    unanswered: Mapping[int, float] = field(default_factory=dict)
    """Number of a renewal -> when it was sent."""
    confirmed_at: float | None = None
    """When the newest answered renewal was sent."""
    content: Content = Content()
    """The content of the last renewal."""
    since: int = 0
    """Number of the first renewal that said it."""
    said_at: float | None = None
    """When that was sent."""
    wants: tuple[object, ...] = ()
    wants_since: int = 0
    """The same of what it wants."""
    peer: int = -1
    """Highest known incarnation of the other machine."""
    report: Report | None = None
    """Its last report."""

    @property
    def lost_at(self) -> float | None:
        """When the other machine may begin to let go, if no further renewal is answered; None if none ever was."""
        return None if self.confirmed_at is None else self.confirmed_at + self.duration * (1 - MARGIN)

    @property
    def next_at(self) -> float:
        """When the next renewal is due if nothing changes."""
        return 0.0 if self.sent_at is None else self.sent_at + self.duration / RENEWALS

    def lasting(self, duration: float) -> Link:
        """Return the link with another duration of its leases; it must be confirmed anew, because the lease in force
        there has the former one."""
        if duration == self.duration:
            return self
        return replace(self, duration=duration, sent_at=None, unanswered={}, confirmed_at=None)

    def live(self, now: float) -> bool:
        """Whether the lease is certainly still in force there."""
        return self.lost_at is not None and now < self.lost_at

    def due(self, now: float, content: Content) -> bool:
        """Whether a renewal must be sent now."""
        return content != self.content or now >= self.next_at

    def since_of(self, content: Content) -> int:
        """Return the number of the first renewal that says this, if the next one does."""
        return self.since if content == self.content and self.since else self.number + 1

    def sent(self, renewal: Renewal, now: float) -> Link:
        """Note a renewal that is about to be sent."""
        recent = dict([*self.unanswered.items()][-MOST_UNANSWERED + 1 :])
        link = replace(self, number=renewal.number, sent_at=now, unanswered={**recent, renewal.number: now})
        if renewal.since != renewal.number:
            return link
        link = replace(link, content=renewal.content, since=renewal.number, said_at=now)
        if renewal.wants == self.wants and self.wants_since:
            return link
        return replace(link, wants=renewal.wants, wants_since=renewal.number)

    def answered(self, answer: Answer) -> Link:
        """Note an answer. If it is to a later rorg of this machine than any that was counted here, this one says a
        higher number from now on, to that machine alone: what one machine claims means nothing to the others."""
        incarnation, number = answer.newest
        if incarnation > self.own:
            return replace(self, own=incarnation + 1)
        if answer.incarnation < self.peer or incarnation != self.own:
            return self
        sent = self.unanswered.get(number)
        link = self if answer.incarnation == self.peer else replace(self, peer=answer.incarnation, report=None)
        link = link.reported(answer.report) if answer.report else link
        if sent is None:
            return link
        left = {n: at for n, at in self.unanswered.items() if n > number}
        confirmed = sent if self.confirmed_at is None else max(sent, self.confirmed_at)
        return replace(link, unanswered=left, confirmed_at=confirmed)

    def reported(self, report: Report) -> Link:
        """Note a report, unless a later one is known."""
        if report.incarnation < self.peer or (self.report is not None and report.stamp <= self.report.stamp):
            return self
        return replace(self, peer=report.incarnation, report=report)

    def known(self, now: float) -> Report | None:
        """Return how the other machine's services are; None while that is not known."""
        return self.report if self.live(now) else None

    def heard(self, number: int) -> bool:
        """Whether the last report takes renewal `number` into account."""
        return self.report is not None and self.report.heard >= (self.own, number)
