"""Three machines of one robot in virtual time, over links that delay, lose, repeat and reorder messages, or are cut in
one direction. The machines use the real rules (rorg/core/links.py, ownership.py, peers.py, wanted.py); only engines and
sockets are played.

`World(seed).run()` plays one random schedule and raises Violation if a rule was broken. Rules are those of
docs/explanation/machines.md, by number.
"""

from __future__ import annotations

import heapq
import itertools
import os
import random
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace

from rorg.core import links, ownership
from rorg.core.desired import Desired, desire
from rorg.core.links import Answer, Granted, Link, Remote, Renewal, Report
from rorg.core.ownership import Owned
from rorg.core.peers import heard, peers
from rorg.core.wanted import wanted
from rorg.model.catalog import DEVELOPER, Catalog, Request, Service
from rorg.model.machines import Machine

NAMES = ("base", "head", "arm")
LEASE = 10.0
DRIFT = 0.01
"""Clocks run up to 1 % too fast or too slow: a hundred times worse than quartz."""
TROUBLE, CALM = 40.0, 30.0
"""Seconds of each schedule with faults, and without."""
STOPS = 0.7
"""Seconds until a stopped service is gone."""


class Violation(AssertionError):
    """A rule was broken."""


def tree(owners: Mapping[str, str]) -> Catalog:
    """The manifests of one revision: each service needs some others, across machines. `a2` and `h2` request each other:
    a ring that nothing else wants must cease."""
    needs = {"b1": ("h1",), "h1": ("a1",), "a1": (), "b2": ("a1", "h2"), "h2": (), "a2": (), "m1": ("a1",)}
    services = {n: Service(n, machine=owners[n], needs=needs[n], spec={"image": "x"}) for n in needs}
    ring = tuple(Request(f"ring-{a}", a, (b,), standing=True) for a, b in (("a2", "h2"), ("h2", "a2")))
    machines = {n: Machine(n, f"{n}:1", lease=LEASE) for n in NAMES}
    return Catalog({DEVELOPER: Service(DEVELOPER, meta=True), **services}, requests=ring, machines=machines)


HOME = {"b1": "base", "b2": "base", "h1": "head", "h2": "head", "a1": "arm", "a2": "arm", "m1": "base"}
MOVED = {**HOME, "m1": "head", "h1": "arm"}


def seen(catalog: Catalog, here: str) -> Desired:
    return desire(replace(catalog, services={n: _seen(s, here) for n, s in catalog.services.items()}))


def _seen(service: Service, here: str) -> Service:
    away = service.machine if service.machine not in ("", here) else ""
    return replace(service, away=away, spec=None) if away else service


TREES = [{here: seen(tree(owners), here) for here in NAMES} for owners in (HOME, MOVED)]


@dataclass
class Disk:
    """What outlives rorg on a machine."""

    incarnation: int = 0
    owned: Owned = Owned()
    requests: tuple[Request, ...] = ()
    granted: dict[str, Granted] = field(default_factory=dict)
    revision: int = 0


class Node:
    """One machine: its rorg, its engine and its clock."""

    def __init__(self, world: World, name: str) -> None:
        self.world, self.name, self.disk = world, name, Disk()
        self.rate, self.offset = 1 + world.dice.uniform(-DRIFT, DRIFT), world.dice.uniform(0, 1000)
        self.running: set[str] = set()
        self.stopping: dict[str, float] = {}
        """Service -> when it will be gone, in true time."""
        self.up = False
        self.alarm = 0.0
        """When the next tick is due by its clock, besides the regular ones."""
        self.begin()

    @property
    def now(self) -> float:
        return self.offset + self.rate * self.world.time

    def true(self, local: float) -> float:
        """The true time at which its clock shows this."""
        return (local - self.offset) / self.rate

    @property
    def desired(self) -> Desired:
        return TREES[self.disk.revision][self.name]

    def begin(self) -> None:
        """rorg starts."""
        self.up = True
        self.disk.incarnation += 1
        self.links = {m: Link(LEASE, own=self.disk.incarnation) for m in NAMES if m != self.name}
        before = self.disk.granted
        self.granted = {m: links.resumed(g, self.now) for m, g in before.items()}
        self.promised = {m: g.renewal for m, g in before.items()}
        """Leases at the restart: they count for one lease more (rule 7)."""
        self.restarted = self.now
        self.owned = self.disk.owned
        self.versions = itertools.count(1)
        self.report: dict[str, tuple[object, Report]] = {}
        self.world.later(0, self.tick)

    def die(self, power: bool) -> None:
        self.up = False
        if power:
            self.running.clear()
            self.stopping.clear()

    def present(self) -> set[str]:
        return self.running | set(self.stopping)

    # -- a pass ------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        if not self.up:
            return
        self.world.touched.add(self.name)
        belongs = {n: s.machine for n, s in self.desired.catalog.services.items() if s.machine}
        numbers = {m: link.number for m, link in self.links.items()}
        self.owned = ownership.settled(self.owned, belongs, self.name, self.present(), numbers)
        self.disk.owned = Owned(self.owned.owned, self.owned.last)
        mine = [n for n, m in belongs.items() if m == self.name]
        unowned = {n: why for n in mine if (why := self.owned.waits(n, NAMES, self.name))}
        known = peers(self.desired.catalog, self.name, self.links, self.granted, unowned, self.now)
        catalog = heard(self.desired, known.silent).catalog
        requests = (*catalog.requests, *self.disk.requests, *known.requests)
        self.wanted = wanted(catalog, requests, known.excluded)
        self.known = known
        for name in sorted(self.running):
            if name not in self.wanted:
                self.idle(name)
            elif name not in mine:  # what needs it goes on without it, as with any other change of a service
                self.world.stop(self, name)
        for name in mine:
            may = name in self.wanted and name not in unowned and name not in self.present()
            if may and all(self.ready(need) for need in self.desired.catalog.services[name].needs):
                self.world.start(self, name)
        self.send(unowned)
        self.tell()
        if known.deadline is not None and known.deadline != self.alarm:
            self.alarm = known.deadline
            self.world.at(self.true(known.deadline) + 1e-9, self.tick)

    def ready(self, name: str) -> bool:
        service = self.desired.catalog.services[name]
        return not self.known.unready(service) if service.away else name in self.running

    def idle(self, name: str) -> None:
        """Dependants first, also those of other machines, as far as they are known to run."""
        for other in self.desired.dependants.get(name, ()):
            remote = self.known.remotes.get(other)
            if other in self.present() or (remote is not None and remote.state == "running"):
                return
        self.world.stop(self, name)

    def send(self, unowned: Mapping[str, str]) -> None:
        for machine, link in self.links.items():
            renewal = Renewal(
                self.name,
                f"boot of {self.name}",
                self.disk.incarnation,
                link.number + 1,
                0,
                LEASE,
                self.disk.requests,
                takes=tuple(n for n in unowned),
            )
            renewal = replace(renewal, since=link.since_of(renewal.content))
            if link.due(self.now, renewal.content):
                self.links[machine] = link.sent(renewal, self.now)
                self.world.send(self.name, machine, renewal)

    def tell(self) -> None:
        """Report how its services are, whenever that changes."""
        for machine in self.links:
            lease = self.granted.get(machine)
            services, stamp = self.states(), lease.renewal.stamp if lease else (0, 0)
            content = services, lease.renewal.changed if lease else ()
            if machine not in self.report or self.report[machine][0] != content:
                report = Report(self.disk.incarnation, next(self.versions), stamp, services)
                self.report[machine] = content, report
                self.world.send(self.name, machine, report)

    def states(self) -> dict[str, Remote]:
        mine = (n for n, s in self.desired.catalog.services.items() if s.machine == self.name)
        return {n: self.state(n) for n in mine}

    def state(self, name: str) -> Remote:
        there = "running" if name in self.present() else "none"
        return Remote(there, name in self.wanted, name in self.running and name in self.wanted, "", "")

    # -- messages ----------------------------------------------------------------------------------------------

    def receive(self, sender: str, message: Renewal | Answer | Report) -> None:
        if not self.up:
            return
        self.world.touched.add(self.name)
        link, owned = self.links[sender], self.owned
        if isinstance(message, Renewal):
            self.renew(sender, message)
            return
        if isinstance(message, Report):
            self.links[sender] = link.reported(message)
        else:
            self.links[sender] = link.answered(message)
            if message.newest[0] == self.disk.incarnation:
                self.owned = ownership.answered(self.owned, sender, message.newest[1], message)
        after = self.links[sender]
        news = after.report is not link.report or after.live(self.now) != link.live(self.now) or self.owned != owned
        if news:
            self.tick()

    def renew(self, sender: str, renewal: Renewal) -> None:
        lease = links.grant(self.granted.get(sender), renewal, self.now)
        if lease is not None:
            before = self.granted.get(sender)
            self.granted[sender] = lease
            self.promised.pop(sender, None)
            if (
                before is None
                or before.renewal.content != renewal.content
                or before.renewal.stamp[0] != renewal.stamp[0]
            ):
                self.disk.granted[sender] = lease
                self.world.later(0, self.tick)
            self.world.accepted(self, sender, renewal)
        newest = self.granted[sender].renewal
        belongs = {n: s.machine for n, s in self.desired.catalog.services.items() if s.machine}
        released, kept = ownership.replies(self.owned, belongs, self.name, self.present(), newest.takes)
        report = self.report.get(sender)
        answer = Answer(self.disk.incarnation, newest.stamp, released, kept, report[1] if report else None)
        self.world.send(self.name, sender, answer)


class World:
    """Plays one schedule."""

    def __init__(self, seed: int) -> None:
        self.dice, self.time = random.Random(seed), 0.0
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self.loss, self.slow = self.dice.choice((0.0, 0.05, 0.3)), self.dice.choice((0.05, 1.0, 8.0))
        self.cut: dict[tuple[str, str], float] = {}
        """Direction -> until when nothing passes."""
        self.seen: dict[tuple[str, str], int] = {}
        """(owner, sender) -> highest accepted incarnation."""
        self.accepted_at: dict[tuple[str, str], float] = {}
        """(owner, sender) -> when a renewal was accepted last, by the owner's clock."""
        self.events = 0
        self.touched: set[str] = set()
        """Machines that the present event concerns."""
        self.nodes = {}
        for name in NAMES:
            self.nodes[name] = Node(self, name)

    def at(self, time: float, call: Callable[[], None]) -> None:
        heapq.heappush(self._events, (max(time, self.time), next(self._order), call))

    def later(self, delay: float, call: Callable[[], None]) -> None:
        self.at(self.time + delay, call)

    def run(self) -> None:
        for name in NAMES:
            self._beat(name)
        for _ in range(self.dice.randint(3, 14)):
            self.at(self.dice.uniform(0, TROUBLE), self.dice.choice(self._faults()))
        self._until(TROUBLE)
        self._calm()
        self._until(TROUBLE + CALM)
        self._settled()

    def _beat(self, name: str) -> None:
        """A pass at least every other second, whatever happens."""
        self.nodes[name].tick()
        self.later(2.0, lambda: self._beat(name))

    def _until(self, end: float) -> None:
        while self._events and self._events[0][0] <= end:
            self.time, _, call = heapq.heappop(self._events)
            self.touched = set()
            call()
            self.events += 1
            self.check()

    # -- faults ------------------------------------------------------------------------------------------------

    def _faults(self) -> list[Callable[[], None]]:
        return [self._request, self._request, self._cut, self._cut, self._part, self._restart, self._power, self._move]

    def _request(self) -> None:
        node = self.nodes[self.dice.choice(NAMES)]
        if node.up:
            names = self.dice.sample(sorted(HOME), self.dice.randint(0, 2))
            others = tuple(r for r in node.disk.requests if r.id != "task")
            before = node.disk.requests
            node.disk.requests = (*others, Request("task", DEVELOPER, tuple(names))) if names else others
            node.tick()
            if self.dice.random() < 0.3:  # and back, before anybody has acted on it
                node.disk.requests = before
                node.tick()

    def _cut(self) -> None:
        """One direction."""
        sender, receiver = self.dice.sample(NAMES, 2)
        self.cut[sender, receiver] = self.time + self.dice.uniform(1, 40)

    def _part(self) -> None:
        """One machine from both others, in both directions."""
        alone, until = self.dice.choice(NAMES), self.time + self.dice.uniform(1, 40)
        for other in NAMES:
            self.cut[alone, other] = self.cut[other, alone] = until

    def _restart(self, power: bool = False) -> None:
        node = self.nodes[self.dice.choice(NAMES)]
        if node.up:
            node.die(power)
            self.later(self.dice.uniform(0.1, 25), lambda: None if node.up else node.begin())

    def _power(self) -> None:
        self._restart(power=True)

    def _move(self) -> None:
        """A commit, or its revert, reaches one machine; it reaches the others when it does."""
        node = self.nodes[self.dice.choice(NAMES)]
        node.disk.revision = 1 - node.disk.revision
        node.tick()

    def _calm(self) -> None:
        self.loss, self.slow = 0.0, 0.05
        self.cut.clear()
        revision = self.nodes["base"].disk.revision
        for node in self.nodes.values():
            node.disk.revision = revision
            if not node.up:
                node.begin()

    def send(self, sender: str, receiver: str, message: Renewal | Answer | Report) -> None:
        if self.cut.get((sender, receiver), 0.0) > self.time:
            return
        for _ in range(2 if self.dice.random() < self.loss / 2 else 1):
            if self.dice.random() >= self.loss:
                delay = self.dice.expovariate(1 / self.slow) if self.slow > 0.1 else self.dice.uniform(0, self.slow)
                self.later(delay, lambda: self.nodes[receiver].receive(sender, message))

    # -- engines -----------------------------------------------------------------------------------------------

    def start(self, node: Node, name: str) -> None:
        for other in self.nodes.values():
            if other is not node and name in other.present():
                raise Violation(f"rule 1: {name} is started on {node.name} and runs on {other.name}")
        if node.desired.catalog.services[name].machine != node.name:
            raise Violation(f"rule 1: {node.name} starts {name}, which is not its own")
        node.running.add(name)

    def stop(self, node: Node, name: str) -> None:
        mine = node.desired.catalog.services[name].machine == node.name
        if mine and name in self._in_force(node):
            raise Violation(f"rule 4: {node.name} stops {name}, which is wanted")
        node.running.discard(name)
        node.stopping[name] = self.time + STOPS

        def gone() -> None:
            node.stopping.pop(name, None)
            node.tick()

        self.later(STOPS, gone)

    def _in_force(self, node: Node) -> set[str]:
        """What is wanted on a machine by requests of its own and by leases that have not ended, found from the leases
        themselves."""
        live = {
            m: g.renewal
            for m, g in node.granted.items()
            if node.now < self.accepted_at.get((node.name, m), node.restarted) + g.renewal.duration
        }
        catalog = heard(node.desired, frozenset(NAMES) - {node.name} - live.keys()).catalog
        requests = [*catalog.requests, *node.disk.requests, *(r for renewal in live.values() for r in renewal.requests)]
        return set(wanted(catalog, requests))

    # -- rules -------------------------------------------------------------------------------------------------

    def accepted(self, owner: Node, sender: str, renewal: Renewal) -> None:
        key = owner.name, sender
        if renewal.incarnation < self.seen.get(key, 0):
            raise Violation(f"rule 6: {owner.name} accepts an earlier rorg of {sender}")
        self.seen[key] = renewal.incarnation
        self.accepted_at[key] = owner.now

    def check(self) -> None:
        """Check the machines that something has happened to, in both directions."""
        for owner, sender in itertools.permutations(NAMES, 2):
            if self.nodes[owner].up and (owner in self.touched or sender in self.touched):
                self._check_pair(self.nodes[sender], self.nodes[owner])

    def _check_pair(self, sender: Node, owner: Node) -> None:
        lease, now = owner.granted.get(sender.name), self.time
        counts = lease is not None and lease.live(owner.now)
        accepted_at = max(self.accepted_at.get((owner.name, sender.name), -1e9), owner.restarted)
        if counts and owner.now >= accepted_at + LEASE:
            raise Violation(f"rule 2: a lease of {sender.name} outlives its duration on {owner.name}")
        link = sender.links[owner.name]
        if sender.up and link.live(sender.now) and link.lost_at is not None:
            until = owner.true(lease.until) if lease is not None else now
            if sender.true(link.lost_at) > until + 1e-6:
                raise Violation(f"rule 3: {sender.name} relies on {owner.name} for longer than the lease")
        if sender.up and not link.live(sender.now) and link.known(sender.now) is not None:
            raise Violation(f"rule 5: {sender.name} claims to know {owner.name} without a link")
        before = owner.promised.get(sender.name)
        promised = before is not None and owner.now < owner.restarted + before.duration
        if promised and not (lease and counts and before and lease.renewal.requests == before.requests):
            raise Violation(f"rule 7: {owner.name} forgot the requests of {sender.name} with its restart")

    def _settled(self) -> None:
        """After all faults: everything that is wanted runs, and nothing else, each service where it belongs."""
        requests = tuple(r for n in self.nodes.values() for r in n.disk.requests)
        for node in self.nodes.values():
            for other in self.nodes.values():
                if other is not node and node.granted[other.name].renewal.requests != other.disk.requests:
                    raise Violation(f"rule 8: {node.name} has other requests of {other.name} than that one")
        for node in self.nodes.values():
            if node.known.pending or node.known.unknown:
                raise Violation(f"rule 8: {node.name} still waits to hear of {sorted(node.known.pending)}")
            catalog = TREES[node.disk.revision][node.name].catalog
            every = replace(catalog, requests=(*catalog.requests, *requests))
            should = {n for n in wanted(every, every.requests) if catalog.services[n].machine == node.name}
            if node.present() != should:
                raise Violation(f"liveness: {node.name} runs {sorted(node.present())} instead of {sorted(should)}")


def _play(seeds: range) -> tuple[int, str]:
    """Events of these schedules, and the first violation."""
    events = 0
    for seed in seeds:
        world = World(seed)
        try:
            world.run()
        except Violation as broken:
            return events, f"schedule {seed}: {broken}"
        events += world.events
    return events, ""


def play(first: int, count: int, processes: int) -> int:
    """Plays schedules in several processes; 0 if no rule was broken."""
    began, size = time.monotonic(), 250
    parts = [range(at, min(at + size, first + count)) for at in range(first, first + count, size)]
    with ProcessPoolExecutor(processes) as pool:
        results = list(pool.map(_play, parts))
    broken = [why for _, why in results if why]
    events = sum(number for number, _ in results)
    print(f"machines: {count} schedules, {events} events, {len(broken)} violations, {time.monotonic() - began:.0f} s")
    print("\n".join(broken[:20]))
    return 1 if broken else 0


if __name__ == "__main__":
    number = int(os.environ.get("RORG_TEST_SCHEDULES", "1000"))
    sys.exit(play(int(os.environ.get("RORG_TEST_SCHEDULES_FROM", "0")), number, os.cpu_count() or 1))
