"""Judges the history: the standings of revisions, and where a rollback leads, by what was done and by what ran."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from soak_random.judge import Fault, Run

PROVEN = 15.0
"""Seconds of a run after which its edition must be proven, if nothing is wrong with it."""


@dataclass(frozen=True)
class Tried:
    """What the soak knows of a revision."""

    bad: frozenset[str] = frozenset()
    """Services that cannot work as it declares them."""
    touched: frozenset[str] = frozenset()
    """Services that something else may have made fail: somebody ended them by hand."""
    editions: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """Service -> the numbers of its manifest and of its file."""


def history_faults(
    listed: Sequence[Mapping[str, Any]], tried: Mapping[int, Tried], runs: Sequence[Run], at: float
) -> list[Fault]:
    """Revisions whose standing says something else than what happened. `listed`: as `rorg history -o json`."""
    found = []
    for row in listed:
        known = tried.get(row["number"])
        if known is None:
            continue
        name = f"revision {row['number']}"
        if known.bad and (row["standing"] == "good" or row["proven_at"]):
            why = f"{name} is {row['standing']}, proven at '{row['proven_at']}', and {sorted(known.bad)} cannot work"
            found.append(Fault("history", at, why, tuple(sorted(known.bad))))
        if row["standing"] == "failed" and not known.bad and not any(s in row["reason"] for s in known.touched):
            found.append(Fault("history", at, f"{name} has failed ({row['reason']}), and nothing of it is bad"))
        if known.editions and row["standing"] == "good" and (never := _never_ran(row["number"], listed, tried, runs)):
            why = f"{name} is good, and {', '.join(never)} never ran as it declares them"
            found.append(Fault("history", at, why, tuple(never)))
    return found


def _never_ran(
    number: int, listed: Sequence[Mapping[str, Any]], tried: Mapping[int, Tried], runs: Sequence[Run]
) -> list[str]:
    """Services that a revision changed since the last good one, and that never ran since."""
    good = (r["number"] for r in listed if r["number"] < number and r["standing"] == "good" and r["number"] in tried)
    base = next(good, None)
    changes = _changes(tried[number], tried[base]) if base else []
    ran = {(run.service, run.edition) for run in runs}
    return [service for service in changes if (service, tried[number].editions[service][0]) not in ran]


@dataclass(frozen=True)
class Goal:
    """Of `rorg rollback`: a revision, or none with a reason."""

    number: int | None
    refusal: str = ""


def rollback_faults(
    goal: Goal, listed: Sequence[Mapping[str, Any]], tried: Mapping[int, Tried], runs: Sequence[Run], at: float
) -> list[Fault]:
    """What is wrong with the goal of a rollback. `listed`: the newest first."""
    if goal.number is None and not goal.refusal:
        return [Fault("history", at, "a rollback is refused without a reason")]
    force = next((row for row in listed if row["standing"] != "refused"), None)
    now, then = tried.get(force["number"] if force else 0), tried.get(goal.number or 0)
    if force is None or now is None:
        return []
    if then and (why := _unproven(then, now, runs)):
        return [Fault("history", at, f"a rollback from {force['number']} leads to revision {goal.number}, where {why}")]
    best = _last_proven(listed, force, tried, runs)
    if best and best > (goal.number or 0):
        why = f"is refused ({goal.refusal})" if goal.number is None else f"leads to revision {goal.number}"
        return [Fault("history", at, f"a rollback from {force['number']} {why}, and revision {best} was proven")]
    return []


def _changes(then: Tried, now: Tried) -> list[str]:
    return [service for service, numbers in then.editions.items() if now.editions.get(service) != numbers]


def _unproven(then: Tried, now: Tried, runs: Sequence[Run]) -> str:
    """Why an earlier revision cannot have been proven; "" if it can."""
    changes = _changes(then, now)
    if bad := sorted(then.bad.intersection(changes)):
        return f"{', '.join(bad)} cannot work"
    ran = {(run.service, run.edition) for run in runs}
    never = [service for service in changes if (service, then.editions[service][0]) not in ran]
    return f"{', '.join(never)} never ran" if never else ""


def _last_proven(
    listed: Sequence[Mapping[str, Any]], force: Mapping[str, Any], tried: Mapping[int, Tried], runs: Sequence[Run]
) -> int:
    """The newest revision to which a rollback must be able to lead; 0 if that is not known of any."""
    same = [r["number"] for r in listed if r["fingerprint"] == force["fingerprint"] and r["standing"] != "refused"]
    refused, failed = listed[0]["standing"] == "refused", force["standing"] == "failed"
    end = listed[0]["number"] if refused else force["number"] if failed else min(same)
    ran = {(run.service, run.edition) for run in runs if run.end - run.begin > PROVEN}
    for row in listed:
        then = tried.get(row["number"])
        fits = row["number"] < end and (refused or row["number"] not in same) and row["commit"] and not row["dirty"]
        if then and fits and row["standing"] == "good" and not then.bad:
            changes = _changes(then, tried[force["number"]])
            sure = all((s, then.editions[s][0]) in ran and s not in then.touched for s in changes)
            if changes and sure and not any(then.editions[s][1] for s in changes):
                return int(row["number"])
    return 0
