"""How a state of the manifests stands (rorg/core/standing.py), and what a plan shows of each service (overview.py)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from situations import ARM, BASE, NOW, RUN, SPEC, box, situation, up

from rorg.core.decide import Decision, decide
from rorg.core.desired import desire
from rorg.core.incremental import plan_all
from rorg.core.inputs import Inputs
from rorg.core.memory import STALLED_AFTER, InFlight, Memory, Progress
from rorg.core.observed import Container, Observed
from rorg.core.operations import Start
from rorg.core.operations import Update as SetOptions
from rorg.core.overview import Overview
from rorg.core.plan import Action, Part
from rorg.core.situation import MissingImage
from rorg.core.standing import APPLYING, BAKING, FAILED, GOOD, UNTESTED, Standing, standing
from rorg.core.update import Update
from rorg.model.catalog import Catalog, Service, Updating
from rorg.model.probe import Probe

ON = replace(BASE, always_on=True)


def baked(service: Service, **more: Any) -> Progress:
    edition = desire(Catalog({service.name: service})).editions[service.name]
    return up(service.name, update=Update(edition=edition, baked=edition), **more)


def decision(*services: Service, seen: tuple[Container, ...] = (), **more: Any) -> Decision:
    declared = {s.name: s for s in services}
    facts: dict[str, Any] = {
        "desired": desire(Catalog(services=declared)),
        "observed": Observed(seen, complete=more.pop("complete", True), looked={c.id: NOW for c in seen}),
        "memory": Memory({s.name: baked(s) for s in services}),
        "now": NOW,
        "owner": "robot",
        "requests": (),
        "restarts": {},
        "results": {},
    }
    return decide(Inputs(**{**facts, **more}))


def stands(*services: Service, good: bool = False, **more: Any) -> Standing:
    return standing(decision(*services, **more), Standing(GOOD) if good else None)


def test_it_is_good_when_all_have_what_they_need_and_stayed_well():
    assert stands(ON, seen=(box(),)) == Standing(GOOD)
    idle = decision(BASE, seen=(box(state="exited"),), memory=Memory())
    assert standing(idle) == Standing(UNTESTED, "no service has run yet")
    assert standing(idle, None, {"base"}) == Standing(UNTESTED, "not run since the change: base")
    assert standing(idle).code == UNTESTED, "after a change of its priority alone, too"
    seen = box(), box("more", state="exited")
    beside = decision(ON, replace(BASE, name="more"), seen=seen, memory=Memory({"base": baked(ON)}))
    assert standing(beside) == Standing(GOOD), "what did not change and does not run says nothing"


def test_it_bakes_until_all_that_is_asked_for_has_stayed_well():
    bakes = Memory({"base": up(update=Update(edition=baked(ON).update.edition))})
    wait = replace(ON, update=Updating(bake=60.0))
    found = stands(wait, seen=(box(),), memory=bakes)
    assert found == Standing(BAKING, "being watched for 60 s: base")


def test_what_is_done_for_the_manifests_is_told_first():
    assert stands(ON) == Standing(APPLYING, "+ create base (no container)")
    idle = box(state="exited")
    assert stands(BASE, seen=(idle, box("gone"))).code == APPLYING
    call = Action(0, Start(container="base"), "base")
    for part, state in ((Part.REPLACE, APPLYING), (Part.NONE, GOOD)):
        flying = Memory({"base": baked(BASE)}, in_flight={"base": InFlight(replace(call, part_of=part), NOW)})
        assert stands(BASE, seen=(idle,), memory=flying).code == state
    live = Action(0, SetOptions(container="base", options={"cpus": 1.0}), "base")
    flying = Memory({"base": baked(BASE)}, in_flight={"base": InFlight(live, NOW)})
    assert stands(BASE, seen=(idle,), memory=flying).code == APPLYING


def test_an_engine_that_does_not_answer_tells_nothing_new():
    assert stands(ON, seen=(box(),), complete=False) == Standing(APPLYING, "the engine does not answer")
    assert stands(ON, seen=(box(),), complete=False, good=True) == Standing(GOOD)


def test_a_failed_change_counts_even_for_what_was_good():
    edition = baked(ON).update.edition
    failed = Memory({"base": up(update=Update(edition=edition, quarantined={edition: "it ended"}))})
    for good in (False, True):
        assert stands(ON, seen=(box(),), memory=failed, good=good) == Standing(FAILED, "base: it ended")


def broken(service: Service = ON, **more: Any) -> Memory:
    """It ended again and again in the desired edition."""
    edition = baked(service).update.edition
    known = {"exits": STALLED_AFTER, "error": "exit code 1", "exited": RUN, "update": Update(edition=edition, **more)}
    return Memory({service.name: replace(Progress(), **known)})


def test_what_ends_again_and_again_makes_it_fail():
    ended = box(state="exited", exit_code=1)
    fails = Standing(FAILED, "base: exit code 1")
    assert stands(ON, seen=(ended,), memory=broken()) == fails
    edition = baked(ON).update.edition
    assert stands(ON, seen=(ended,), memory=broken(baked=edition), good=True) == fails, "it was well before"
    released = Memory({"base": replace(Progress(), update=Update(edition=edition, crashing={edition: "exit code 1"}))})
    assert stands(BASE, seen=(ended,), memory=released) == fails, "a release repairs nothing"


def test_what_failed_stays_so_until_it_is_proven():
    failed = Standing(FAILED, "base: image x cannot be pulled")
    idle = decision(BASE, seen=(box(state="exited"),), memory=Memory())
    assert standing(idle, failed, {"base"}) == failed, "its image is there now, and it has not run"
    assert standing(decision(ON, seen=(box(),)), failed, {"base"}) == Standing(GOOD)
    unanswered = decision(ON, seen=(box(),), complete=False)
    assert standing(unanswered, failed, {"base"}) == failed


def test_an_image_that_cannot_be_had_makes_it_fail():
    lacks = {"x": MissingImage("cannot be pulled", True)}
    assert stands(ON, images=lacks) == Standing(FAILED, "base: image x cannot be pulled")
    pulled = {"x": MissingImage("is being pulled", False)}
    assert stands(ON, images=pulled) == Standing(APPLYING, "base: image x is being pulled")


def test_what_waits_is_told_with_its_reason():
    changed = box(spec={"image": "y"})
    later = replace(ON, update=Updating(when="when_ceased"))
    found = stands(later, seen=(changed,), memory=Memory({"base": baked(later)}))
    assert found.code == APPLYING
    assert found.reason.startswith("base: changed: image; takes effect")


# -- the overview ----------------------------------------------------------------------------------------------


def entries(*services: Service, **more: Any) -> dict[str, tuple[list[str], str, list[str]]]:
    """Service -> verbs, reason, changes."""
    found = situation(*services, **more)
    shown = Overview(found, plan_all(found).plan()).as_json()
    return {e["service"]: (e["verbs"], e["why"], [c["text"] for c in e["changes"]]) for e in shown}


def test_each_service_is_told_once_with_what_changed():
    changed = box(spec={"image": "y"})
    assert entries(BASE, seen=(changed,)) == {"base": (["replace"], "image: y -> x", ["image: y -> x"])}
    assert entries(BASE, seen=(box(),)) == {}
    created = entries(BASE, seen=())
    assert created == {"base": (["create", "start"], "no container; always on", [])}


def test_a_restart_for_another_reason_shows_no_changes():
    limited = replace(BASE, spec={**SPEC, "cpus": 2.0})
    was = box(spec={**SPEC, "cpus": 1.0}, digest="before", live={"cpus": 1.0})
    assert entries(limited, seen=(was,))["base"] == (["update"], "cpus: 1.0 -> 2.0", ["cpus: 1.0 -> 2.0"])
    hung = entries(limited, seen=(box(spec=limited.spec, live={"cpus": 2.0}),), restarts={"base": RUN})
    assert hung["base"] == (["restart"], "restart requested", [])


def test_what_is_followed_and_waited_for_is_told():
    found = entries(BASE, ARM, seen=())
    assert found["arm"] == (["create", "start"], "no container; always on; after base", [])
    waits = entries(BASE, ARM, seen=(box(state="exited"), box("arm", "exited")), unplugged={"base": "no device"})
    assert waits["base"] == (["wait"], "no device", [])
    assert waits["arm"] == (["wait"], "base waits: no device", [])


def test_a_change_of_probes_alone_is_shown_and_restarts_nothing():
    ready = replace(BASE, ready=Probe("tcp", "127.0.0.1:8080", timeout=30.0))
    found = situation(ready, ARM, seen=(box(), box("arm")))
    before = {"base": replace(BASE, ready=Probe("tcp", "127.0.0.1:9090", timeout=30.0)), "arm": ARM, "gone": ARM}
    overview = Overview(found, plan_all(found).plan(), before)
    assert [e.line(7, 4) for e in overview.entries()] == [
        "~   probe   base  ready.tcp: 9090 -> 8080; probes only, no restart"
    ]
    assert overview.text().splitlines() == [overview.entries()[0].line(7, 4), "Plan: 1 to probe differently."]
    assert not overview.empty
    same = Overview(found, plan_all(found).plan(), {"base": ready})
    assert (same.empty, same.text()) == (True, "No differences.\n")


def test_a_replacement_shows_changed_probes_too():
    found = situation(replace(BASE, live=Probe("exec", ("true",), interval=10.0)), seen=(box(spec={"image": "y"}),))
    overview = Overview(found, plan_all(found).plan(), {"base": BASE})
    (entry,) = overview.entries()
    assert (entry.verbs, entry.why) == (("replace",), "image: y -> x; live.exec: (unset) -> true")
    assert overview.summary() == "Plan: 1 to replace."


def test_waiting_is_said_once():
    """A reason may have a verb of its own."""
    changed, pair = box(spec={"image": "y"}), Updating(atomic="pair")
    services = replace(BASE, update=pair), replace(ARM, needs=(), update=pair)
    known = {"base": up(update=Update(held="arm"))}
    assert entries(*services, seen=(changed, box("arm")), known=known)["base"][1] == (
        "image: y -> x; waits for the new container of arm, which changes together with it"
    )


def test_a_unified_diff_is_shown_of_what_is_made_changed_or_removed():
    changed, gone = box(spec={"image": "y"}), box("gone", "exited")
    found = situation(BASE, ARM, seen=(changed, gone, box("arm")))
    texts = Overview(found, plan_all(found).plan()).unified()
    assert {name: [line for line in text.splitlines() if line[0] in "+-"][2:] for name, text in texts.items()} == {
        "base": ['-image: "y"', "+image: x"],
        "gone": ["-image: x"],
    }
    started = situation(BASE, seen=(box(state="exited"),))
    assert Overview(started, plan_all(started).plan()).unified() == {}
    made = situation(BASE)
    (text,) = Overview(made, plan_all(made).plan()).unified().values()
    assert text.splitlines()[0] == "--- base (no container)"
