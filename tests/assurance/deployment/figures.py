"""Figures of a week that was played, from its record (see auditor.py)."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

from deployment.tour_guide import MASTER, Guide
from deployment.week import Bad, Kind

from rorg.tools.sim.generate import BEHAVIOUR

BOUND = 10.0
"""Seconds within which all services of a request should be ready."""
UPDATES = (Kind.SOFTWARE, Kind.CONFIGURATION)
ENGINE = (Kind.ENGINE_KILLED, Kind.ENGINE_STOPPED, Kind.ENGINE_BARE)
LASTS = {
    **dict.fromkeys((*UPDATES, Kind.REVERT), 60.0),
    Kind.KILL: 10.0,
    Kind.RORG_KILLED: 20.0,
    **dict.fromkeys(ENGINE, 20.0),
    **dict.fromkeys((Kind.ENGINE_CUT, Kind.ENGINE_SILENT), 30.0),
}
"""Kinds of events that can end a service, and for how many seconds afterwards they may. An update is fetched, and its
image built, before anything ends."""
UNKNOWN = "not known"
FOLLOWED, AWAITED = f"restart of {MASTER}, which it follows", f"end of {BEHAVIOUR}, which asks for it"
FOLLOWS = 35.0
"""Seconds for which these may take: rorg restarts two services at a time if no request waits for them."""
LEFT_OVER, LET_GO = "the end of the request before, which came late", 20.0
"""The cause if a service that still ran from an earlier request is paused or stopped so soon after the next one."""
SLOW, MISSED = "none: a slow answer of a program that ran on", 0.6
"""Seconds without an answer that say nothing, if no run ended: the machine is busy."""
UNTRIED = "not tried before it was reverted"
NO_REASON = (UNKNOWN, Kind.RORG_KILLED, Kind.ENGINE_KILLED, Kind.ENGINE_STOPPED, Kind.ENGINE_CUT, Kind.ENGINE_SILENT)
"""Containers must outlive all of these."""


class Played(NamedTuple):
    at: float
    kind: Kind
    service: str
    bad: Bad
    state: str
    outcome: str


class Down(NamedTuple):
    """A service that was asked for, and had answered, does not answer."""

    service: str
    begin: float
    end: float
    cause: str


class Start(NamedTuple):
    """Of a container's program, or the creation of a container, in which nothing was changed."""

    at: float
    service: str
    what: str
    cause: str


class Fate(NamedTuple):
    """Of a bad update."""

    at: float
    bad: Bad
    service: str
    outcome: str
    down: float
    """Seconds in which the service did not answer although it was asked for."""


@dataclass(frozen=True)
class Request:
    """A state of the behaviour, with all services that it takes."""

    state: str
    begin: float
    end: float
    ready: float | None
    """Seconds until all of them answered."""

    @property
    def outcome(self) -> str:
        if self.ready is not None and self.ready <= BOUND:
            return "in time"
        return "late" if self.end - self.begin > BOUND else "withdrawn"


class Figures:
    def __init__(self, record: Mapping[str, Any], guide: Guide) -> None:
        self.record, self.guide = record, guide
        self.events = [Played(at, Kind(k), s, Bad(b), state, o) for at, k, s, b, state, o in record["events"]]
        times = (record[name] for name in ("events", "asked", "answers", "samples"))
        self.end = max(rows[-1][0] for rows in times if rows)
        self.said: dict[str, list[tuple[float, str]]] = defaultdict(list)
        for at, service, answer in record["answers"]:
            self.said[service].append((at, answer))
        self.asked = {name: [*self._asked(name)] for name in guide.services}
        """Service -> when it was asked for, from and to."""
        self.downs = [down for name in guide.services for down in self._downs(name)]
        self.requests = [*self._requests()]

    # -- availability ------------------------------------------------------------------------------------------

    def _asked(self, name: str) -> Iterator[tuple[float, float]]:
        begin = None
        for at, _, wanted in [*self.record["asked"], [self.end, "", ()]]:
            if begin is None and name in wanted:
                begin = at
            elif begin is not None and name not in wanted:
                yield begin, at
                begin = None

    def answers(self, name: str, begin: float, end: float) -> Iterator[tuple[float, float, str]]:
        """(from, to, what it said) while it was asked for."""
        found = [(at, said) for at, said in self.said[name] if begin <= at < end]
        for (at, said), (until, _) in pairwise([*found, (end, "")]):
            yield at, until, said

    def _downs(self, name: str) -> Iterator[Down]:
        for begin, end in self.asked[name]:
            was_up = False
            for at, until, said in self.answers(name, begin, end):
                was_up = was_up or bool(said)
                if was_up and not said:
                    yield Down(name, at, until, self._why_down(name, begin, at, until))

    def _why_down(self, name: str, asked: float, at: float, until: float) -> str:
        ran_on = not any(at - 1 <= ended <= until for ended in self.runs(name, "die"))
        if ran_on and until - at < MISSED:
            return SLOW
        cause = self.cause(name, at)
        return LEFT_OVER if cause in NO_REASON and asked > 0 and at < asked + LET_GO else cause

    def runs(self, name: str, action: str) -> list[float]:
        return [at for at, what, service, _, _ in self.record["runs"] if (what, service) == (action, name)]

    def cause(self, name: str, at: float) -> str:
        """The event that has most to do with a service, and of those the last one before this time."""
        changed = self._changed(name, at)
        found = [
            (self._distance(e, changed), -e.at, f"bad {e.kind}" if e.bad and e.kind in UPDATES else str(e.kind))
            for e in self.events
            if e.service in ("", name)
            and not e.outcome
            and e.bad is not Bad.INVALID
            and e.at - 0.5 <= at <= e.at + LASTS.get(e.kind, -1.0)
        ]
        follows, waits = self.guide.follows(name), not self.guide.specs[name].get("always_on")
        for distance, text, times in (
            (1, FOLLOWED, self.runs(MASTER, "start") if follows else ()),
            (2, AWAITED, self.runs(BEHAVIOUR, "die") if waits else ()),
        ):
            found += [(distance, -since, text) for since in times if since - 1 <= at <= since + FOLLOWS]
        return min(found, default=(0, 0.0, UNKNOWN))[2]

    @staticmethod
    def _distance(event: Played, changed: bool) -> int:
        """An update ends a run only if another specification follows, or if it is bad."""
        if not event.service:
            return 0 if event.kind is Kind.ENGINE_BARE else 3
        return 0 if changed or event.kind is Kind.KILL or (event.bad and event.kind in UPDATES) else 4

    def _changed(self, name: str, at: float) -> bool:
        """Whether the next run has another specification."""
        started = [(t, digest) for t, what, s, _, digest in self.record["runs"] if (what, s) == ("start", name)]
        before = [digest for t, digest in started if t < at - 0.3][-1:]
        return before != [digest for t, digest in started if t >= at - 0.3][:1]

    def _requests(self) -> Iterator[Request]:
        rows = self.record["asked"]
        for (begin, state, wanted), (end, _, _) in pairwise([*rows, [self.end, "", ()]]):
            if state == "night":
                continue
            ready = [self._first_answer(name, begin, end) for name in wanted]
            late = any(one is None for one in ready)
            yield Request(state, begin, end, None if late else max(one - begin for one in ready if one is not None))

    def _first_answer(self, name: str, begin: float, end: float) -> float | None:
        since = next((span for span in self.asked[name] if span[0] <= begin < span[1]), None)
        for at, until, said in self.answers(name, *since) if since else ():
            if said and until > begin and at < end:
                return max(at, begin)
        return None

    def availability(self) -> dict[str, tuple[float, float]]:
        """Service -> seconds for which it was asked for and had answered, seconds of these in which it answered."""
        found = {}
        for name, spans in self.asked.items():
            down = sum(d.end - d.begin for d in self.downs if d.service == name)
            counted = sum(end - at for begin, end in spans if (at := self._first_answer(name, begin, end)) is not None)
            found[name] = (counted, counted - down)
        return found

    def parts(self, seconds: float) -> list[tuple[float, float]]:
        """(end of a part of the week, part of all that was asked for and had answered that answered in it)."""
        found = []
        for number in range(int(self.end // seconds)):
            a, b = number * seconds, (number + 1) * seconds
            asked = sum(max(0.0, min(b, end) - max(a, begin)) for s in self.asked.values() for begin, end in s)
            down = sum(max(0.0, min(b, d.end) - max(a, d.begin)) for d in self.downs)
            found.append((b, 1 - down / asked))
        return found

    # -- restarts ----------------------------------------------------------------------------------------------

    def starts(self) -> list[Start]:
        """Containers that began again, or were created again, although nothing of them had changed."""
        found, began, made, ended = [], dict[str, str](), dict[str, str](), dict[str, float]()
        for at, action, name, _, digest in self.record["runs"]:
            if action == "die":
                ended[name] = at
            known = {"start": began, "create": made}.get(action)
            if known is not None:
                if known.get(name) == digest:
                    found.append(Start(at, name, action, self._why(name, ended.get(name, at), at)))
                known[name] = digest
        return found

    def _why(self, name: str, ended: float, at: float) -> str:
        """Why a run ended, or was followed by another one of the same."""
        begin = next((begin for begin, end in self.asked[name] if begin <= ended - 1 and at + 1 <= end), None)
        if begin is None:
            return "it was not asked for in between"
        cause = self.cause(name, ended)
        return LEFT_OVER if cause in NO_REASON and begin > 0 and ended < begin + LET_GO else cause

    # -- updates -----------------------------------------------------------------------------------------------

    def fates(self) -> list[Fate]:
        return [self._fate(event) for event in self.events if event.bad and event.kind in UPDATES]

    def _fate(self, event: Played) -> Fate:
        later = (e.at for e in self.events if e.kind is Kind.REVERT and e.service == event.service and e.at > event.at)
        end = next(later, self.end)
        told = {(kind, name) for at, kind, name, _ in self.record["journal"] if event.at <= at <= end}
        if event.bad is Bad.INVALID:
            outcome = "refused" if ("tree-refused", "") in told else "not noticed"
        elif ("update-failed", event.service) in told:
            outcome = "taken back"
        else:
            outcome = "on trial when it was reverted" if self._tried(event, end) else UNTRIED
        answers = (one for span in self.asked[event.service] for one in self.answers(event.service, *span))
        down = sum(until - at for at, until, said in answers if not said and event.at <= at <= end)
        return Fate(event.at, event.bad, event.service, outcome, down)

    def _tried(self, event: Played, end: float) -> bool:
        """Whether a container that was created for it has been started."""
        rows = [row for row in self.record["runs"] if row[2] == event.service and event.at <= row[0] <= end]
        made = {container for _, action, _, container, _ in rows if action == "create"}
        return any(action == "start" and container in made for _, action, _, container, _ in rows)

    def unjust(self) -> list[tuple[float, str, str]]:
        """(at, service, what rorg said) of updates that rorg took back although nothing was wrong with them."""
        bad = {(f.service, f.at) for f in self.fates()}
        return [
            (at, name, text)
            for at, kind, name, text in self.record["journal"]
            if kind == "update-failed" and not any(name == n and since <= at <= since + 120 for n, since in bad)
        ]

    def took_effect(self) -> list[float]:
        """Seconds from a good update of a service that was asked for to the first answer of its new edition."""
        found, numbers = [], Counter[str]()
        for event in (e for e in self.events if e.kind in UPDATES):
            numbers[event.service] += 1
            place, number = UPDATES.index(event.kind), str(numbers[event.service])
            for begin, end in self.asked[event.service]:
                if not event.bad and begin <= event.at < end:
                    said = ((at, text.split()) for at, text in self.said[event.service] if begin <= at < end and text)
                    found += [at - event.at for at, words in said if words[place] == number][:1]
        return found
