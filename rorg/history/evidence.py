"""The verdict on each edition of a service: it has stayed well, or it fails. A rollback trusts nothing else."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from rorg.history.damage import check_types
from rorg.history.database import Database
from rorg.history.revisions import UNDER_WAY, Revision, Revisions, Span

PROVEN, FAILS = "proven", "fails"
ROLLBACK = re.compile(r"Roll back(?: \S+)? to (?:\S+ \()?([0-9a-f]{12})\)?:")
"""The subject of a commit that a rollback made, with the commit that it led to."""
SEARCHED = 1000
"""Revisions that are searched for one to return to, the newest first."""
MOST = 20
"""Revisions that are offered, apart from those that cannot be trusted."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """`code` is PROVEN or FAILS, with the reason."""

    service: str
    edition: str
    code: str
    reason: str = ""
    proven_at: str = ""
    """When it was proven last, even if it fails now: ISO 8601 in UTC. Only known of what is on record."""


class Evidence:
    """The table of verdicts, one for each edition of a service: the last one. The owner of the file writes it."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self._written: dict[tuple[str, str], str] = {}
        """The codes that this object wrote."""

    def note(self, verdicts: Iterable[Verdict], at: str) -> None:
        """Record the verdicts that are news. `at` is ISO 8601 in UTC."""
        news = [v for v in verdicts if self._written.get((v.service, v.edition)) != v.code]
        if not news:
            return
        sql = (
            "INSERT INTO verdict (service, edition, code, reason, at, proven_at) VALUES (?, ?, ?, ?, ?, ?)"
            " ON CONFLICT (service, edition) DO UPDATE SET code = excluded.code, reason = excluded.reason,"
            " at = excluded.at, proven_at = max(proven_at, excluded.proven_at) WHERE code <> excluded.code"
        )
        self._written |= {(v.service, v.edition): v.code for v in news}
        rows = [(v.service, v.edition, v.code, v.reason, at, at if v.code == PROVEN else "") for v in news]
        self.database.write([(sql, rows)])

    def all(self) -> dict[tuple[str, str], Verdict]:
        """By (service, edition)."""
        known = self.database.read(_verdict, "SELECT service, edition, code, reason, proven_at FROM verdict")
        return {(verdict.service, verdict.edition): verdict for verdict in known}


def _verdict(*row: str) -> Verdict:
    """Raises ValueError and TypeError if it is damaged."""
    check_types(row, *[str] * 5)
    verdict = Verdict(*row)
    if verdict.code not in (PROVEN, FAILS):
        raise ValueError(f"the verdict of {verdict.service} is {verdict.code}")
    return verdict


@dataclass(frozen=True, slots=True)
class Earlier:
    """An earlier revision as the goal of a rollback. `doubt` says why it cannot be trusted; "" if it can."""

    number: int
    doubt: str = ""
    unchanged: tuple[str, ...] = ()
    """Services that fail now, and that a return to it would not change, though they were well once."""


def earlier_revisions(database: Database) -> list[Earlier]:
    """Return the revisions that a rollback may return to, the newest first, up to MOST that can be trusted.

    A revision can be trusted if each service that the rollback would change has been proven as it was then, and has not
    failed since, and if the rollback would change each service that fails now and was well once. Other services that
    stay the same say nothing about it: a camera that never worked is broken in both. While the current revision is not
    proven yet, a superseded one cannot be trusted if it has the same unproven change.
    """
    revisions, known = Revisions(database), Evidence(database).all()
    listed, force = revisions.list(SEARCHED), revisions.in_force()
    fails = force is not None and force.standing == "failed"
    found: list[Earlier] = []
    for number in _before(listed, {r.number: r.fingerprint for r in listed}, fails=fails):
        then = revisions.get(number)
        if then and force and sum(not e.doubt for e in found) < MOST:
            found.append(_judged(then, force, known))
    return found


def earlier_states(database: Database, service: str) -> list[Earlier]:
    """Return the revisions that a rollback of one service may return to, the newest first, up to MOST that can be
    trusted. The service was different in them, and only its own verdict counts."""
    revisions, known = Revisions(database), Evidence(database).all()
    listed, force, spans = revisions.list(SEARCHED), revisions.in_force(), revisions.spans(service)
    editions = {r.number: e for r in listed if (e := _edition_in(spans, r.number))}
    verdict = known.get((service, editions.get(force.number, ""))) if force else None
    found: list[Earlier] = []
    for number in _before(listed, editions, fails=verdict is not None and verdict.code == FAILS):
        if number in editions and sum(not e.doubt for e in found) < MOST:
            found.append(Earlier(number, _doubt_of({service: known.get((service, editions[number]))})))
    return found


def _edition_in(spans: Iterable[Span], number: int) -> str:
    """Return the edition that a service had in a revision; "" if it was not declared."""
    return next((s.edition for s in spans if s.first <= number <= (s.last or number)), "")


def _before(listed: Sequence[Revision], contents: Mapping[int, str], *, fails: bool) -> list[int]:
    """Return the numbers of revisions from before the current one with other contents, the newest first. `contents`:
    what identifies them, by number. `fails`: whether the current ones fail.

    Refused manifests are not in force: those before them are, so they are the first to return to.
    """
    in_force = [r for r in listed if r.standing != "refused"]
    if not in_force:
        return []
    if listed[0].standing == "refused":
        return [r.number for r in in_force]
    now = contents.get(in_force[0].number)
    end = in_force[0].number if fails else _origin(in_force, contents)
    return [r.number for r in in_force if r.number < end and contents.get(r.number) != now]


def _origin(in_force: Sequence[Revision], contents: Mapping[int, str]) -> int:
    """Return the number of the revision in which the current contents began. If a rollback brought them back, they
    began where it led, so that a second rollback goes further back, and not to what the first one left."""
    begin, goal = in_force[0], ""
    for revision in in_force:
        if contents.get(revision.number) == contents.get(begin.number):
            if not goal or revision.commit.startswith(goal):
                begin, goal = revision, ""
        elif not goal:
            led = ROLLBACK.match(begin.subject)
            if not led:
                break
            goal = led[1]
    return begin.number


def _judged(then: Revision, now: Revision, known: Mapping[tuple[str, str], Verdict]) -> Earlier:
    """Return an earlier revision with the doubt about it."""
    editions = {name: made.edition for name, made in now.services.items()}
    to_mend = _failing(editions, known)
    unchanged = tuple(n for n in to_mend if n in then.services and then.services[n].edition == editions[n])
    if unchanged:
        return Earlier(then.number, f"it does not change what fails now: {', '.join(unchanged)}", unchanged)
    missing = [n for n in to_mend if n not in then.services]
    return Earlier(then.number, f"it does not declare {', '.join(missing)}" if missing else _doubt(then, now, known))


def _failing(editions: Mapping[str, str], known: Mapping[tuple[str, str], Verdict]) -> list[str]:
    """Return the services that fail in these editions, and were well once in any edition. Nothing on record mends
    others."""
    well_once = _well_once(known)
    return [n for n, e in editions.items() if n in well_once and (v := known.get((n, e))) and v.code == FAILS]


def _well_once(known: Mapping[tuple[str, str], Verdict]) -> set[str]:
    return {v.service for v in known.values() if v.proven_at}


def _doubt(then: Revision, now: Revision, known: Mapping[tuple[str, str], Verdict]) -> str:
    """Return why an earlier revision cannot be trusted."""
    editions = {name: made.edition for name, made in now.services.items()}
    changed = {n: m.edition for n, m in then.services.items() if editions.get(n) != m.edition}
    if doubt := _doubt_of({name: known.get((name, edition)) for name, edition in changed.items()}):
        return doubt
    same = {n: e for n, e in editions.items() if n in then.services and n not in changed}
    pending = [n for n, e in same.items() if (n, e) not in known and n in _well_once(known)]
    if pending and then.standing == "superseded" and now.standing in UNDER_WAY:
        return f"{', '.join(pending)} was not proven in it"
    if changed or editions.keys() != then.services.keys() or then.standing == "good":
        return ""
    # Nothing that runs tells them apart, so the standing of the whole counts.
    return f"it failed ({then.reason})" if then.standing == "failed" else f"it is {then.standing}"


def _doubt_of(verdicts: Mapping[str, Verdict | None]) -> str:
    """Return which services were not well as they were then; "" if all were."""
    failed = [f"{name} failed in it ({v.reason})" for name, v in verdicts.items() if v and v.code == FAILS]
    untried = [name for name, verdict in verdicts.items() if verdict is None]
    if failed:
        return "; ".join(failed)
    if untried:
        return f"{', '.join(untried)} never ran as declared then"
    return ""
