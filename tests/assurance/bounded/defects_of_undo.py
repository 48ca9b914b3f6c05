"""Defects of undo to plant: of the history, rollbacks, mounted files, interrupted trials, joined services, holds and
clocks (see defects.py). Each has a walk that shows it."""

from __future__ import annotations

from bounded.defect import PLAN, RIVALS, TOGETHER, Defect
from bounded.steps import Step
from bounded.walks import REST, Walk
from bounded.worlds import Feature

TRUST, KEPT, NEVER = "the history trusts nothing bad", "what failed stays failed", "no bad revision is good"
AGAIN, HOLD = "what failed is not tried again", "a hold lasts as long as it said"
ASKED: tuple[Step, float] = (("request", 0), 6.0)
"""A service is requested, and stays well."""
PROBED: tuple[Feature, ...] = (("probe", "0"),)
OTHER: tuple[Step, float] = (("request", 1), 6.0)


def walk(*steps: tuple[Step, float], features: tuple[Feature, ...] = (), services: int = 1) -> Walk:
    return Walk(services, features, steps)


DEFECTS_OF_UNDO = (
    Defect(
        "a release and a retry make what failed as good as new",
        "core/standing.py",
        "    return before if before and before.code == FAILED and now.code != GOOD else now\n",
        "    return now\n",
        (KEPT,),
        walk=walk(ASKED, (("spoil", 0), REST), (("release", 0), 1.0), (("retry", 0), REST)),
    ),
    Defect(
        "mounted files are left out of the edition",
        "core/desired.py",
        '**_probes(service), "content": content})',
        "**_probes(service)})",
        (TRUST, NEVER),
        walk=walk(ASKED, (("spoil_file", 0), REST), features=(("file", "0"),)),
    ),
    Defect(
        "mounted files are left out of the fingerprint",
        "core/desired.py",
        '        sources["files"] = files\n',
        '        sources["files"] = ""\n',
        ("what was good is a goal of rollback",),
        walk=walk(ASKED, (("file", 0), 6.0), (("spoil_file", 0), REST), features=(("file", "0"),)),
    ),
    Defect(
        "a rollback leads to what failed",
        "history/evidence.py",
        "if v and v.code == FAILS]",
        'if v and v.code == ""]',
        (TRUST,),
        walk=walk(ASKED, OTHER, (("spoil", 0), REST), (("undo", 0), 6.0), (("change", 1), REST), services=2),
    ),
    Defect(
        "a rollback leads to what never ran",
        "history/evidence.py",
        "    if untried:\n",
        "    if untried is None:\n",
        (TRUST,),
        walk=walk(OTHER, (("spoil", 0), 1.0), (("undo", 0), 1.0), (("change", 1), REST), services=2),
    ),
    Defect(
        "a new rorg remembers nothing",
        "daemon/history.py",
        "        memory = remembered(self.runs.read(), now, boot)\n",
        "        memory = remembered({}, now, boot)\n",
        (AGAIN,),
        walk=walk(ASKED, (("spoil", 0), 6.0), (("reborn",), REST)),
    ),
    Defect(
        "what outlives rorg is written only when a service goes",
        "daemon/history.py",
        "        if changed or gone:\n",
        "        if gone:\n",
        (AGAIN,),
        walk=walk(ASKED, (("spoil", 0), 6.0), (("reborn",), REST)),
    ),
    Defect(
        "a trial that a kill of rorg interrupts has failed",
        "core/transitions.py",
        "    return progress.rebooted or ((current.killed or tried) and again)\n",
        "    return progress.rebooted\n",
        (KEPT,),
        walk=walk(ASKED, (("change", 0), 1.0), (("both", 0), REST)),
    ),
    Defect(
        "an end during an outage of the engine is a failure",
        "core/transitions.py",
        "        return again and (evidence.outage or (tried and (current.vanished or current.signalled)))\n",
        "        return again and (tried and (current.vanished or current.signalled))\n",
        (KEPT,),
        walk=walk(ASKED, (("change", 0), 1.0), (("outage",), REST)),
    ),
    Defect(
        "what was never tried is good",
        "core/standing.py",
        "    if idle := [n for n in untried if n in changed]:\n",
        "    if idle := [n for n in untried if n in ()]:\n",
        (TRUST, NEVER),
        walk=walk(OTHER, (("spoil", 0), REST), services=2),
    ),
    Defect(
        "a run proves a file that it has not read",
        "core/rollout.py",
        '    if service.on_change != "none" and update.changed_content(',
        '    if service.on_change == "" and update.changed_content(',
        (TRUST, NEVER),
        walk=walk(
            ASKED,
            OTHER,
            (("spoil_file", 0), 6.0),
            (("undo", 0), 6.0),
            (("change", 1), REST),
            features=(("file", "0"), ("deferred", "0")),
            services=2,
        ),
    ),
    Defect(
        "the next change forgets what failed",
        "core/rollout.py",
        "    update = replace(update, edition=edition, since=now, interrupted=0)\n",
        "    update = replace(update, edition=edition, since=now, interrupted=0, quarantined={})\n",
        (AGAIN,),
        walk=walk(ASKED, (("spoil", 0), 6.0), (("change", 0), 6.0), (("revert",), REST)),
    ),
    Defect(
        "what ends again and again has not failed",
        "core/rollout.py",
        "        return progress if update.broken else replace(progress, update=update.noting_crashes(why))\n",
        "        return progress if why else replace(progress, update=update.noting_crashes(why))\n",
        ("what stalls has failed",),
        walk=walk((("spoil", 0), 1.0), (("request", 0), REST)),
    ),
    Defect(
        "two units count as one",
        "core/situation.py",
        "+ sum(self.units(o, resource) for o in users) + sum(left_over.values())",
        "+ len(users) + sum(left_over.values())",
        (RIVALS, TOGETHER),
        walk=walk((("request", 0), 2.0), (("turn", 1), REST), features=(("wide", "0", "1", "2"),), services=3),
    ),
    Defect(
        "a run that a person paused during its stop is no rival",
        "core/situation.py",
        'return flight.action.runs or (flight.action.asks_to_end and any(c.state == "paused" for c in own))',
        "return flight.action.runs",
        (RIVALS, TOGETHER),
        walk=walk(
            (("request", 1), 0.6),
            (("turn", 0), 0.01),
            (("hand_pause", 1), REST),
            features=(("conflict", "0", "1"),),
            services=2,
        ),
    ),
    Defect(
        "a hold ends by the wall clock",
        "core/holds.py",
        "        return hold.uptime - now.uptime\n",
        "        return hold.until - now.wall\n",
        (HOLD,),
        walk=walk((("hold", 0), 0.3), (("ahead",), REST)),
    ),
    Defect(
        "a clock that is set back prolongs a hold",
        "core/holds.py",
        "        return hold.uptime - now.uptime\n",
        "        return max(hold.uptime - now.uptime, hold.until - now.wall)\n",
        (HOLD,),
        walk=walk((("hold", 0), 0.3), (("back",), REST)),
    ),
    Defect(
        "what is joined to a failed container waits for it",
        "core/joining.py",
        "    if pair is None or went_back(*pair):\n",
        "    if pair is None:\n",
        ("a bad change leaves what ran", "nothing waits for itself"),
        walk=walk(
            (("request", 1), 3.0),
            (("spoil", 0), 0.1),
            (("restart", 1), REST),
            features=(("needs", "1", "0"), ("network_mode", "1", "0")),
            services=2,
        ),
    ),
    Defect(
        "what is joined stays with a container that was replaced",
        "core/joining.py",
        "            if left or service.name in view.s.wanted:\n",
        "            if left and service.name in ():\n",
        (
            "what is joined is there",
            "nothing waits for itself",
            "nothing begins beside itself",
            "it comes to rest",
            "all that is asked for and possible is ready",
        ),
        walk=walk(
            (("request", 1), 3.0),
            (("change", 0), REST),
            features=(("needs", "1", "0"), ("network_mode", "1", "0")),
            services=2,
        ),
    ),
    Defect(
        "an interlock holds nothing back",
        "core/gates.py",
        '    locked = view.s.interlocks.get(name, "") if swap or operation.felt else ""\n',
        '    locked = ""\n',
        ("nothing begins while it must not", PLAN),
        walk=walk((("request", 0), 1.0), (("lock", 0), 0.0), (("release", 0), REST), features=(("locked", "0"),)),
    ),
    Defect(
        "a probe that failed stays in force",
        "core/probes_in_force.py",
        "    return replace(service, ready=good.ready, live=good.live)\n",
        "    return service\n",
        ("the hung are restarted",),
        walk=walk(ASKED, (("spoil_live", 0), 40.0), (("freeze", 0), REST), features=PROBED),
    ),
    Defect(
        "a new live probe ends what was proven",
        "core/transitions.py",
        "not is_live_untried(service, progress.update, current)",
        "True",
        ("no new probe ends what was proven",),
        walk=walk(ASKED, (("spoil_live", 0), REST), features=PROBED),
    ),
)
