"""A checkpoint of the random soak: nothing is done for a while, rorg comes to rest, and what it keeps and runs is
compared with what it has acknowledged."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import commands
from rorg_client import Client, Error
from soak_random.actions import LEASE
from soak_random.book import Asked, Book
from soak_random.judge import Fault, runs_of
from soak_random.revisions import Goal, Tried, history_faults, rollback_faults
from soak_random.robot import DRIVERS, REFUSED, SERVICES, SETS, Rorg, rules, with_needs
from soak_random.witness import AWAY, Witness

RESTS = 60.0
"""Seconds within which rorg must come to rest when nobody does anything."""
RESTED = 2.5
"""Seconds without anything to do that count as rest."""
SLACK = 3.0
"""Seconds by which a time of ours may differ from rorg's."""
CRASH_LOOP = 120.0
"""Seconds for which rorg may wait before it starts again what was ended by hand more than once."""
UNDER_WAY = ("applying", "baking")


class Checkpoint:
    def __init__(self, rorg: Rorg, book: Book, witness: Witness) -> None:
        self.rorg, self.book, self.witness, self.rules = rorg, book, witness, rules()
        self.client: Client = rorg.client(timeout=30.0, patience=60.0)

    def check(self) -> list[Fault]:
        status, busy = self.rest()
        now = time.time()
        states = self.witness.states()
        listed = self.history()
        faults = [Fault("lost", now, f"not at rest after {RESTS:g} s: {busy}")] if busy else []
        faults += self.lost_requests(now)
        # An rorg that begins beside manifests with an error has none in force, says so, and changes nothing.
        if any(name in status["services"] for name in SERVICES):
            faults += self.lost_holds(status, now, states) + self.lost_services(now, states)
        return faults + self.history_of(listed, now)

    # -- rest --------------------------------------------------------------------------------------------------

    def rest(self) -> tuple[Mapping[str, Any], str]:
        """The status at rest, and what is still done at the end of RESTS."""
        deadline, since, busy, status = time.monotonic() + RESTS, time.monotonic(), "rorg does not answer", {}
        before: list[str] = []
        while time.monotonic() < deadline:
            with suppress(Error, *AWAY):
                status = self.client.status()
                busy, waits = self.busy(status)
                if busy or waits != before:
                    since, before = time.monotonic(), waits
                elif time.monotonic() - since > RESTED:
                    return status, ""
            time.sleep(0.1)
        return status, busy or str(before)

    def busy(self, status: Mapping[str, Any]) -> tuple[str, list[str]]:
        """What is under way, and what waits. A reason that counts seconds changes until it ends."""
        if not status["engine"]["complete"]:
            return f"engine: {status['engine']['error']}", []
        loops = self.book.tree.bad(self.book.editions)  # what crashes is started again and again
        doing = [str(one) for one in status["plan"]["actions"] if one["service"] not in loops]
        doing += [f"{verb} {name}" for name, verb in status["in_flight"].items() if name not in loops]
        doing += [f"the lease of {request['id']}" for request in status["requests"] if request["ttl"]]
        waits = [f"{w['service']}: {w['reason']}" for w in status["plan"]["waitings"] if w["service"] not in loops]
        return ", ".join(doing), waits

    # -- what was acknowledged ---------------------------------------------------------------------------------

    def lost_requests(self, now: float) -> list[Fault]:
        there = {r["id"]: tuple(r["services"]) for r in self.client.requests() if r["requester"] == "developer"}
        faults = []
        with self.book.lock:
            for id, asked in [*self.book.requests.items()]:
                if id in self.book.unknown:
                    continue
                until = asked.until
                if until is not None and (now > until - SLACK or id not in there):
                    if id in there and now > max(until, self._over_again + LEASE) + SLACK:
                        faults.append(Fault("lost", now, f"the lease of {id} has run out, and it is there"))
                    if id in there or now > until - SLACK:
                        continue
                if there.get(id) != asked.services:
                    faults.append(Fault("lost", now, f"request {id} of {asked.services} is {there.get(id)}"))
            for id in there.keys() - self.book.requests.keys() - self.book.unknown:
                faults.append(Fault("lost", now, f"request {id} of {there[id]} was released, and is there"))
            self._adopt(there)
        return faults

    @property
    def _over_again(self) -> float:
        """When all leases started over: rorg began, or the engine answered again."""
        return max((span.end for span in self.rorg.away), default=0.0)

    def _adopt(self, there: Mapping[str, tuple[str, ...]]) -> None:
        """From now on what rorg has is what was acknowledged, of leases too."""
        leases = {id: asked.until for id, asked in self.book.requests.items() if asked.until is not None}
        known = {id: Asked(services, leases.get(id)) for id, services in there.items()}
        self.book.requests = known
        self.book.unknown = {name for name in self.book.unknown if name.startswith("hold ")}

    def lost_holds(self, status: Mapping[str, Any], now: float, states: Mapping[str, list]) -> list[Fault]:
        faults = []
        for name, until in [*self.book.holds.items()]:
            held = bool(status["services"].get(name, {}).get("held"))
            if f"hold {name}" in self.book.unknown:
                continue
            if now < until - SLACK and not held:
                faults.append(
                    Fault("lost", now, f"the hold of {name} has {until - now:.1f} s left, and is gone", (name,))
                )
            elif now < until - SLACK and any(state == "running" for state, _ in states.get(name, [])):
                faults.append(Fault("lost", now, f"{name} is held, and runs", (name,)))
            if now > until:
                self.book.holds.pop(name)
                if held and now > until + SLACK:
                    faults.append(Fault("lost", now, f"the hold of {name} ended {now - until:.1f} s ago", (name,)))
        self.book.unknown = {name for name in self.book.unknown if not name.startswith("hold ")}
        return faults

    # -- what runs ---------------------------------------------------------------------------------------------

    def lost_services(self, now: float, states: Mapping[str, list[tuple[str, int]]]) -> list[Fault]:
        """Services that must run and do not, run in another edition, or run although nothing wants them."""
        editions, kinds = self.book.editions, self.book.tree.kinds
        direct = {s for one in self.book.requests.values() for s in one.services}
        direct |= {name for name, spec in SERVICES.items() if spec.get("always_on")}
        asked = with_needs(direct)
        running = {name for name, there in states.items() if any(state == "running" for state, _ in there)}
        refused = any(kinds[number] == REFUSED for number, _ in editions.values())
        faults = []
        for name in sorted(asked):
            there = states.get(name, [])
            if name not in running:
                users = (user for user in direct if name in with_needs([user]))
                if not self.excuse(name, running, now) and not all(self.excuse(u, running, now) for u in users):
                    faults.append(Fault("lost", now, f"{name} is wanted, and is {there}", (name,)))
            elif not refused and not self._free(name):
                ran = [number for state, number in there if state == "running"]
                if ran != [editions[name][0]]:
                    what = f"{name} runs in edition {ran} in place of {editions[name][0]}"
                    faults.append(Fault("lost", now, what, (name,)))
        for name in sorted(running - asked):
            faults.append(Fault("lost", now, f"{name} runs, and nothing wants it", (name,)))
        return faults

    def _free(self, name: str) -> bool:
        """Whether rorg may run an earlier edition: the present one is bad, was ended by hand, or waits for a person."""
        editions, partners = self.book.editions, next((s for s in SETS if name in s), frozenset((name,)))
        bad = self.book.tree.bad(editions)
        return name in DRIVERS or any(one in bad or (one, editions[one]) in self.book.touched for one in partners)

    def excuse(self, name: str, running: Iterable[str], now: float) -> str:
        """Why a wanted service need not run."""
        bad = self.book.tree.bad(self.book.editions)
        for one in with_needs([name]):
            if self.book.holds.get(one, 0.0) > now - SLACK:
                return f"{one} is held"
            if one in bad:
                return f"{one} is bad"
            hands = [h for h in self.book.hands if h.service == one and h.end > now - CRASH_LOOP]
            if len(hands) > 1 or (one, self.book.editions[one]) in self.book.touched:
                return f"{one} was ended by hand"
            if broken := self.rules.broken([*(r for r in running if r != one), one]):
                return broken
        return ""

    # -- history -----------------------------------------------------------------------------------------------

    def history(self) -> list[dict[str, Any]]:
        """As `rorg history -o json` says it, once no revision is under way, or after some seconds."""
        deadline = time.monotonic() + 12.0
        while True:
            done = self._rorg("history", "-o", "json", "--number", "60")
            listed = json.loads(done.stdout)
            if time.monotonic() > deadline or not listed or listed[0]["standing"] not in UNDER_WAY:
                return listed
            time.sleep(0.5)

    def history_of(self, listed: list[dict[str, Any]], now: float) -> list[Fault]:
        """Compares it with what each revision declared. Only the newest can be told: it is what is on the disk."""
        editions, kinds, book = self.book.editions, self.book.tree.kinds, self.book
        if listed and listed[0]["standing"] != "refused" and not any(kinds[n] == REFUSED for n, _ in editions.values()):
            book.tried[listed[0]["number"]] = Tried(book.tree.bad(editions), frozenset(), editions)
        for number, known in book.tried.items():
            touched = frozenset(s for s, numbers in book.touched if known.editions[s] == numbers)
            book.tried[number] = replace(known, touched=touched)
        runs = runs_of(self.witness.known(), book.hands)
        faults = history_faults(listed, book.tried, runs, now)
        done = self._rorg("rollback", "--print", "--manifests", str(self.rorg.tree))
        goal = Goal(self._goal(done.stdout, listed), done.stderr.strip() if done.returncode else "")
        book.count("rollback to a revision" if goal.number else "rollback refused")
        if done.returncode not in (0, 2, 5):
            faults.append(Fault("history", now, f"rorg rollback --print: exit {done.returncode}: {done.stderr}"))
        if not done.returncode and not goal.number:
            return faults  # to a commit that is not listed
        return faults + rollback_faults(goal, listed, book.tried, runs, now)

    def _goal(self, printed: str, listed: Iterable[Mapping[str, Any]]) -> int | None:
        """The revision that a rollback leads to, by the commit that its commands name."""
        whole = (r for r in listed if r["commit"] and not r["dirty"])
        return next((r["number"] for r in whole if r["commit"][:12] in printed), None)

    def _rorg(self, *words: str) -> Any:
        return commands.run([*words], self.rorg.environment(), cwd=self.rorg.folder, timeout=120.0)
