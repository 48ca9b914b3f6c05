"""This machine's part in a robot of several: what it owns, what the others told it, and what it tells them.

The loop calls known() and decided() in each pass. Threads of the server (rorg/api/links.py) carry messages; they may
call everything else at any time.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path

from rorg.core import ownership
from rorg.core.decide import Decision
from rorg.core.desired import Desired
from rorg.core.links import Answer, Content, Granted, Link, Remote, Renewal, Report, grant, resumed
from rorg.core.observed import Observed
from rorg.core.ownership import Owned
from rorg.core.peers import NOBODY, Peers, heard, peers
from rorg.core.received import LONGEST_REASON
from rorg.core.schedule import told_since
from rorg.core.status import Status, Statuses
from rorg.errors import Unreachable
from rorg.model.catalog import Catalog
from rorg.store import machine_file
from rorg.store.machine_file import NAME, Known


class Machines:
    """`wake` wakes the loop, whose clock is `clock`. Leases are counted by `now`, which goes on while the computer is
    suspended: the other machines go on, too. Nothing happens, and nothing is written, for a robot of one machine."""

    def __init__(
        self,
        directory: Path,
        clock: Callable[[], float],
        wake: Callable[[], None],
        tell: Callable[[str, str], None],
        boot: str = "",
        now: Callable[[], float] = lambda: time.clock_gettime(time.CLOCK_BOOTTIME),
    ) -> None:
        self.path, self.clock, self.wake, self.tell, self.boot = directory / NAME, clock, wake, tell, boot
        self.now = now
        self.changed = threading.Condition()
        """Guards everything here; notified when something may have to be sent, or may be reported."""
        self.here = ""
        self.catalog = Catalog()
        self.links: dict[str, Link] = {}
        self.granted: dict[str, Granted] = {}
        self.owned = Owned()
        self.incarnation = 0
        self.trouble: dict[str, str] = {}
        """Machine -> why the last call to it failed."""
        self.version = 0
        """Of the last report."""
        self.services: Mapping[str, Remote] = {}
        """Its content."""
        self._known = machine_file.read(self.path)
        """The content of the file."""
        self._begun = False
        self._present: Collection[str] = ()
        self._heard: Mapping[str, Granted] = {}
        """The leases that the last decision includes."""
        self._told: Mapping[str, Granted] = {}
        """Those that the last report includes."""
        self._content: dict[str, Content] = {}
        """Machine -> what the next renewal says."""
        self._desired: tuple[Desired, frozenset[str], Desired] | None = None
        self._since: dict[str, float] = {}
        """Service -> since when another machine waits for it."""

    # -- the loop ----------------------------------------------------------------------------------------------

    def known(
        self, desired: Desired, here: str, observed: Observed, in_flight: Collection[str]
    ) -> tuple[Desired, Peers]:
        """Return the desired state as far as other machines may have a say in it, and what is known of them.
        `in_flight`: services for which an engine call is under way."""
        catalog = desired.catalog
        here = here or self._known.here
        if not here:
            return desired, NOBODY
        with self.changed:
            self._begin(here)
            # As long as the engine does not answer, everything that this machine owns may exist.
            present = {*observed.by_service(), *in_flight} | (set() if observed.complete else self.owned.owned)
            self.catalog, self._present = catalog, present
            self.links = {
                name: (self.links.get(name) or self._new_link(name, machine.lease)).lasting(machine.lease)
                for name, machine in catalog.machines.items()
                if name != here
            }
            belongs = self._belongs()
            numbers = {name: link.number for name, link in self.links.items()}
            self.owned = ownership.settled(self.owned, belongs, here, present, numbers)
            self._write(self.granted)
            mine = [name for name, machine in belongs.items() if machine == here]
            unowned = {n: why for n in mine if (why := self.owned.waits(n, self.links, here))}
            unowned |= {n: f"{self.path} cannot be written" for n in self.owned.owned - self._known.owned.owned}
            known = peers(catalog, here, self.links, self.granted, unowned, self.now())
            self._heard = dict(self.granted)
        if self._desired is None or self._desired[0] is not desired or self._desired[1] != known.silent:
            self._desired = desired, known.silent, heard(desired, known.silent)
        return self._desired[2], known.shifted(self.clock() - self.now())

    def _begin(self, here: str) -> None:
        """Take up what the disk has, in the first pass of a robot of several machines."""
        self.here = here
        if self._begun:
            return
        self._begun, now = True, self.now()
        self.owned, self.incarnation = self._known.owned, self._known.incarnation + 1
        for name, renewal in self._known.leases.items():
            self.granted.setdefault(name, resumed(Granted(renewal, now), now))

    def _new_link(self, machine: str, lease: float) -> Link:
        return Link(lease, own=self.incarnation + self._known.ahead.get(machine, 0))

    def own(self, machine: str) -> int:
        """Return the incarnation of this rorg, as a machine is told."""
        link = self.links.get(machine)
        return link.own if link else self.incarnation

    def _belongs(self) -> dict[str, str]:
        """Service -> machine. Once the robot has only one again, everything is that one's."""
        services = self.catalog.services.values()
        return {s.name: s.machine or self.here for s in services if not s.meta}

    def _write(self, granted: Mapping[str, Granted]) -> bool:
        """Write down what has changed, with these leases, because nothing that is not on the disk may have
        consequences; return whether the disk has it."""
        leases = {name: lease.renewal for name, lease in granted.items()}
        ahead = {**self._known.ahead, **{name: link.own - self.incarnation for name, link in self.links.items()}}
        ahead = {name: more for name, more in ahead.items() if more}
        before = self._known
        same = before.leases.keys() == leases.keys() and all(
            said.wants == before.leases[n].wants and said.incarnation == before.leases[n].incarnation
            for n, said in leases.items()
        )
        owned = Owned(self.owned.owned, self.owned.last)
        known = Known(self.here, self.incarnation, owned, leases, ahead)
        if same and known == replace(before, leases=leases):
            return True
        try:
            machine_file.write(self.path, known)
        except OSError as error:
            self.tell("machine-not-written", f"cannot write {self.path}: {error.strerror or error}")
            return False
        self._known = known
        return True

    def decided(self, decision: Decision, asked: Mapping[str, float]) -> None:
        """Note a decision: what the other machines must know of it."""
        if not self.here:
            return
        situation, services = decision.situation, decision.situation.desired.catalog.services
        excluded = {
            n: why[:LONGEST_REASON] for n, why in situation.preempted.items() if self._excludes(n, situation.preempted)
        }
        requests = tuple(replace(r, incarnation=None) for r in decision.settled.requests)
        reported = self._reported(decision)
        with self.changed:
            takes = tuple(sorted(situation.peers.unowned))
            for machine in self.links:
                there = tuple(
                    sorted((n, at) for n, at in asked.items() if n in services and services[n].away == machine)
                )
                self._content[machine] = Content(requests, excluded, there, takes)
            if reported != self.services or self._news():
                self.services, self.version = reported, self.version + 1
                self._told = self._heard
            self.changed.notify_all()

    def _news(self) -> bool:
        """Whether a machine waits to hear that its new requests were taken into account."""
        told = {name: lease.renewal.stamp for name, lease in self._told.items()}
        return any(lease.renewal.changed > told.get(name, (0, 0)) for name, lease in self._heard.items())

    def _excludes(self, name: str, out: Mapping[str, str]) -> bool:
        """Whether this machine itself keeps one of its services from being active. Services that only lack what they
        need are left out: the other machines see that for themselves, and would otherwise see no contest."""
        service = self.catalog.services.get(name)
        return service is not None and service.machine == self.here and not any(n in out for n in service.needs)

    def _reported(self, decision: Decision) -> Mapping[str, Remote]:
        """Return how the services of this machine are: told anew for those that were planned in this pass."""
        mine = decision.situation.desired.digests
        progress = decision.situation.memory.progress.items()
        coming = (name for name, p in progress if p.running_since is not None and not p.ready)  # time makes them late
        whole, replanned = decision.planned.whole, decision.planned.replanned
        anew = mine.keys() if whole else {*replanned, *self._since, *coming} & mine.keys()
        told = Statuses(decision.situation, decision.plan, decision.holds)
        kept = {} if whole else self.services
        return {**kept, **{name: self._remote(told[name], decision) for name in anew}}

    def _remote(self, status: Status, decision: Decision) -> Remote:
        ready = status.condition("Ready")
        since = self._since.get(status.service)
        progress = decision.situation.memory.of(status.service)
        current = decision.situation.observed.current(status.service)
        probed = progress.answered is None or told_since(progress, since)
        return Remote(
            current.state if current else status.state,  # while it stops too, the other machine counts it as alive
            status.wanted,
            status.wanted and ready.status == "True" and probed,
            status.health,
            status.sync,
            status.incarnation,
            (status.trouble or ("" if probed else "its probe has not answered yet"))[:LONGEST_REASON],
        )

    def questions(self) -> Mapping[str, float]:
        """Services that other machines wait for, each with the time since when answers of its probe count."""
        return self._since

    # -- messages ----------------------------------------------------------------------------------------------

    def due(self, machine: str) -> float | None:
        """Return in how many seconds a renewal must be sent to a machine; None if there is nothing to send yet."""
        link, content = self.links.get(machine), self._content.get(machine)
        if link is None or content is None:
            return None
        now = self.now()
        return 0.0 if link.due(now, content) else link.next_at - now

    def renewal(self, machine: str) -> Renewal:
        """Return the next renewal for a machine, which is sent now."""
        link, content = self.links[machine], self._content[machine]
        number, since = link.number + 1, link.since_of(content)
        renewal = Renewal(self.here, self.boot, link.own, number, since, link.duration, *content)
        self.links[machine] = link.sent(renewal, self.now())
        return renewal

    def receive(self, renewal: Renewal) -> Answer:
        """Take a renewal; the answer is given when what it says is on the disk."""
        with self.changed:
            if not self._begun:
                return Answer(0, (0, 0))
            before = self.granted.get(renewal.machine)
            lease = grant(before, renewal, self.now())
            if lease is not None:
                granted = {**self.granted, renewal.machine: lease}
                if not self._write(granted):
                    raise Unreachable("renew the lease", f"{self.path} cannot be written")
                self.granted = granted
                if before is None or before.renewal.changed != renewal.changed:
                    here = (name for name, _ in renewal.asking if name in self.catalog.services)
                    self._since.update(dict.fromkeys(here, self.clock()))
                    self.wake()
                elif before is not None and not before.live(self.now()):
                    self.wake()
            newest = self.granted[renewal.machine].renewal
            belongs = self._belongs()
            owned = replace(self.owned, owned=self.owned.owned | self._known.owned.owned)
            released, kept = ownership.replies(owned, belongs, self.here, self._present, newest.takes)
            report = self.report(renewal.machine)
            return Answer(report.incarnation, newest.stamp, released, kept, report)

    def report(self, machine: str) -> Report:
        """Return how the services of this machine are, for another machine."""
        said = self._told.get(machine)
        return Report(self.own(machine), self.version, said.renewal.stamp if said else (0, 0), self.services)

    def answered(self, machine: str, answer: Answer) -> None:
        """Take the answer of another machine to a renewal."""
        with self.changed:
            link = self.links.get(machine)
            if link is None:
                return
            after, owned = link.answered(answer), self.owned
            if answer.newest[0] == link.own:
                owned = ownership.answered(owned, machine, answer.newest[1], answer)
            if after.own != link.own:
                known = f"{machine} knows a later rorg of {self.here}"
                self.tell("superseded", f"{known}: its state directory was new, or two computers have this name")
            now = self.now()
            news = after.report is not link.report or after.live(now) != link.live(now) or owned != self.owned
            self.links[machine], self.owned = after, owned
        if news:
            self.wake()

    def reported(self, machine: str, report: Report) -> None:
        """Take a report of another machine."""
        with self.changed:
            link = self.links.get(machine)
            after = link.reported(report) if link else None
            if link is None or after is None or after is link:
                return
            self.links[machine] = after
        self.wake()

    def take(self, names: Collection[str]) -> None:
        """A person has confirmed that these services of this machine run on no other one. Raises OSError."""
        with self.changed:
            numbers = {name: link.number for name, link in self.links.items()}
            self.owned = ownership.settled(self.owned, self._belongs(), self.here, self._present, numbers, names)
            self._write(self.granted)
        self.wake()
