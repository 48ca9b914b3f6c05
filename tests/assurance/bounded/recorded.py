"""What the history and orders of people promise, in walks: robots with a real journal, whose edits are known."""

from __future__ import annotations

import re
from graphlib import CycleError, TopologicalSorter

from bounded.registry import at
from bounded.resting import loops, unanswered
from bounded.walk_robot import WalkRobot
from bounded.walk_worlds import Edits
from bounded.watch import Watch

from rorg.core.standing import GOOD
from rorg.history.evidence import MOST
from rorg.model.codes import FAILED


def walker(watch: Watch) -> WalkRobot | None:
    """The robot, if it is one with a journal."""
    return watch.robot if isinstance(watch.robot, WalkRobot) else None


def bad(robot: WalkRobot, edits: Edits) -> list[str]:
    """Services of which no container stays well for its bake as these edits have them. A program that ends after half a
    second has been well for a bake of no time."""
    services = robot.desired.catalog.services
    baked = {n for n in robot.world.names if services[n].update.bake > 0.0}
    return [n for i, n in enumerate(robot.world.names) if edits.bad_probe(i) or (edits.bad(i) and n in baked)]


@at("pass")
def a_hold_lasts_as_long_as_it_said(watch: Watch) -> None:
    """A person's hold lasts for its seconds, however the machine's clock is set and whoever decides."""
    robot = walker(watch)
    for name, until in robot.held.items() if robot else ():
        held = name in watch.robot.decision.holds
        assert held == (watch.robot.now < until), f"{name} is {'' if held else 'not '}held, {until - watch.robot.now} s"


@at("pass")
def no_bad_revision_is_good(watch: Watch) -> None:
    """The history never calls manifests good of which a program does not stay well, also for a moment."""
    if (robot := walker(watch)) is None or (noted := robot.journal.noted) is None:
        return
    standing = robot.journal.historian.standing
    if standing is not None and standing.code == GOOD:
        assert not bad(robot, noted), f"good, with {bad(robot, noted)}"


@at("rest")
def nothing_waits_for_itself(watch: Watch) -> None:
    """At rest no services wait for one another in a ring, except for one whose program is tried again for ever."""
    services = watch.services.keys() - loops(watch)
    # What failed only names the member of its set on account of which it stays as it was.
    waits = [w for w in watch.robot.decision.plan.waitings if w.service in services and w.code != FAILED]
    graph: dict[str, set[str]] = {}
    for waiting in waits:
        names = {n for n in re.findall(r"\w+", str(waiting.reason)) if n in services}
        graph.setdefault(waiting.service, set()).update(names - {waiting.service})
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as ring:
        raise AssertionError(f"they wait for one another: {ring.args[1]}\n{watch.robot.decision.plan.text()}") from ring


@at("rest")
def what_does_not_answer_is_not_ready(watch: Watch) -> None:
    """Nobody relies on a service that never answered its `ready` probe, unless it was proven with another one, or
    answered an earlier one and its change waits."""
    if (robot := walker(watch)) is None:
        return
    deaf = {n for i, n in enumerate(robot.world.names) if robot.edits.probes[i] == "ready"} & unanswered(watch)
    deaf = {name for name in deaf if robot.memory.of(name).ready}
    digests = robot.desired.digests
    ready = deaf - {c.service for c in robot.engine.list() if c.alive and c.digest != digests.get(c.service)}
    assert not ready, f"ready without an answer: {ready}"


@at("rest")
def the_history_trusts_nothing_bad(watch: Watch) -> None:
    """No revision with a bad edition or file is called good, and no rollback leads to one that changes to it."""
    if (robot := walker(watch)) is None:
        return
    states = {r.number: (r, edits) for r, edits in robot.journal.revisions()}
    for number, (revision, edits) in states.items():
        assert revision.standing != "good" or not bad(robot, edits), f"{number} is good with {bad(robot, edits)}"
    for one in robot.journal.earlier():
        edits = states[one.number][1]
        changed = {n for i, n in enumerate(robot.world.names) if differ(edits, robot.edits, i)}
        assert one.doubt or not changed & {*bad(robot, edits)}, f"a rollback leads to {one.number}: {edits}"


def differ(one: Edits, other: Edits, index: int) -> bool:
    """Return whether a service is not the same in both."""
    return any(getattr(one, part)[index] != getattr(other, part)[index] for part in ("editions", "files", "probes"))


@at("rest")
def what_stalls_has_failed(watch: Watch) -> None:
    """Manifests with a bad program that rorg has given up, or starts again and again, have failed."""
    if (robot := walker(watch)) is None or not robot.decision.situation.observed.complete:
        return
    newest, edits = next(robot.journal.revisions())
    stalled = [n for n in bad(robot, edits) if n in watch.services and robot.memory.of(n).stalled]
    assert not stalled or newest.standing == "failed", f"{newest.standing}, though {stalled} ended again and again"


@at("rest")
def what_was_good_is_a_goal_of_rollback(watch: Watch) -> None:
    """From failed manifests, a rollback looks at every earlier revision that is good and differs from them."""
    if (robot := walker(watch)) is None:
        return
    (newest, now), *rest = robot.journal.revisions()
    goals = robot.journal.earlier()
    if newest.standing != "failed" or sum(not one.doubt for one in goals) >= MOST:
        return
    listed = {one.number for one in goals}
    missing = [r.number for r, edits in rest if r.standing == "good" and edits != now and r.number not in listed]
    assert not missing, f"no rollback looks at {missing}"


@at("rest")
def the_journal_keeps_every_revision(watch: Watch) -> None:
    """Neither a kill of rorg nor `down` loses a revision."""
    if (robot := walker(watch)) is not None:
        there = {r.number for r, _ in robot.journal.revisions()}
        assert robot.standings.keys() <= there, f"lost: {robot.standings.keys() - there}"


@at("rest")
def what_failed_stays_failed(watch: Watch) -> None:
    """The history calls no revision anything else that it has called failed, unless it was proven anew."""
    if (robot := walker(watch)) is None:
        return
    for revision, edits in robot.journal.revisions():
        before, now = robot.standings.get(revision.number), revision.standing
        assert before != "failed" or now == "failed" or not bad(robot, edits), f"{revision.number} is {now} again"
        # Without a bake, what ends soon was well for a moment, and what cannot start was not.
        ends = any(edits.bad(i) for i in range(len(robot.world.names)))
        blamed = robot.disturbed or bad(robot, edits) or ends
        assert now != "failed" or blamed, f"{revision.number} failed though it is good"
        robot.standings[revision.number] = now
