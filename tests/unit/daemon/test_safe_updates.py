"""A change is in use for good once it has stayed well for its bake; else it is undone, and waits in quarantine for
another change or a person's word. What goes together goes back together."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import pytest
from changed_services import WELL, changed
from robots import VirtualRobot, handed_on, write_tree
from standing import stands
from statuses import statuses
from updates import later, retry

from rorg.core.desired import desire
from rorg.core.memory import Progress
from rorg.core.standing import standing
from rorg.core.update import LastGood, Update
from rorg.daemon.saved_memory import remembered, saved_progress
from rorg.model.probe import Probe


@pytest.fixture
def virtual(tmp_path):
    return VirtualRobot(tmp_path)


def spoil(virtual, name: str, how: str = "exit") -> str:
    """What is declared of a service does not run."""
    digest = virtual.sim.desired.digests[name]
    virtual.sim.faults.bad[digest] = how
    return digest


def ids(virtual) -> dict[str, str]:
    return {c.service: c.id for c in virtual.containers() if c.state == "running"}


# -- bake ------------------------------------------------------------------------------------------------------


def test_what_ends_within_its_bake_is_undone_and_who_follows_it_is_whole_again(virtual):
    tour = {"always_on": True, "needs": [{"service": "nav", "restart": True}]}
    virtual.declare({"nav": {**WELL, "ready": {"tcp": 1}}, "tour": tour})
    virtual.settle()
    before, run = virtual.container("nav").id, virtual.container("tour").incarnation
    virtual.declare({"nav": changed(1, ready={"tcp": 1}, update={"bake": "1m"}), "tour": tour})
    virtual.wait(lambda: ids(virtual).get("nav", before) != before)
    later(virtual, 30)
    assert virtual.container("tour").incarnation != run, "it follows what is ready, though that bakes"
    assert len(virtual.containers()) == 3
    assert stands(virtual) == "baking"
    beside = virtual.container("tour").started_at
    virtual.kill("nav")
    virtual.wait(lambda: ids(virtual).get("nav") == before)
    virtual.wait(lambda: virtual.container("tour").started_at > beside and ids(virtual).get("tour"))
    virtual.wait(lambda: len(virtual.containers()) == 2)
    assert "ended with exit code 137" in virtual.waits("nav")
    assert "rorg retry nav" in virtual.waits("nav")
    assert stands(virtual) == "failed"


@pytest.mark.parametrize("bake", ["0s", "1m"])
def test_the_container_before_is_kept_for_the_bake_and_no_longer(virtual, bake):
    virtual.declare({"nav": {**WELL, "ready": {"delay": "1s"}}})
    virtual.settle()
    later(virtual, 5)
    virtual.declare({"nav": changed(1, ready={"delay": "1s"}, update={"bake": bake})})
    later(virtual, 1.1)
    assert len(virtual.containers()) == 2, "it is not ready yet"
    later(virtual, 50)
    assert len(virtual.containers()) == (1 if bake == "0s" else 2)
    later(virtual, 20)
    assert len(virtual.containers()) == 1
    assert stands(virtual) == "good"


def test_what_does_not_answer_its_live_probe_within_its_bake_is_undone(virtual):
    spec = {"ready": {"tcp": 1}, "live": {"tcp": 1, "interval": "1s"}, "update": {"bake": "1m"}}
    virtual.declare({"nav": {**WELL, **spec}})
    virtual.settle()
    before = virtual.container("nav").id
    virtual.declare({"nav": changed(1, **spec)})
    virtual.wait(lambda: ids(virtual).get("nav", before) != before)
    later(virtual, 10)
    virtual.sim.hung.add(virtual.container("nav").incarnation)
    virtual.wait(lambda: ids(virtual).get("nav") == before)
    assert "did not answer" in virtual.waits("nav")


@pytest.mark.slow
@pytest.mark.parametrize("before", [{}, {"live": {"tcp": 2}}], ids=["none before", "another before"])
def test_a_new_live_probe_ends_nothing_before_it_has_held(virtual, before):
    """It may be wrong, and the program is fine."""
    virtual.declare({"nav": {**WELL, **before}})
    virtual.settle()
    later(virtual, 60)
    run = virtual.run_of("nav")
    virtual.declare({"nav": {**WELL, "live": {"tcp": 1, "interval": "1s"}}})
    virtual.sim.deaf.add("tcp 127.0.0.1:1")
    later(virtual, 20)
    virtual.sim.reborn(handed_on(virtual.sim.decision))
    later(virtual, 120)
    assert virtual.run_of("nav") == run
    found = statuses(virtual)["nav"]
    assert "its change failed: did not answer" in found.trouble
    assert found.condition("Ready").status == "True"
    virtual.sim.deaf.clear()
    retry(virtual, "nav")
    later(virtual, 60)
    assert not statuses(virtual)["nav"].trouble
    virtual.sim.hung.add(run)
    virtual.wait(lambda: virtual.run_of("nav") != run)


def test_a_proven_live_probe_counts_also_while_another_change_bakes(virtual):
    spec = {**WELL, "live": {"tcp": 1, "interval": "1s"}}
    virtual.declare({"nav": spec})
    virtual.settle()
    later(virtual, 60)
    run = virtual.run_of("nav")
    virtual.declare({"nav": {**spec, "ready": {"tcp": 1}, "update": {"bake": "10m"}}})
    later(virtual, 10)
    virtual.sim.hung.add(run)
    virtual.wait(lambda: virtual.run_of("nav") != run)


LIVE = {"live": {"tcp": 1, "interval": "1s"}}
WRONG = "tcp 127.0.0.1:99"
"""Nothing answers there."""


@pytest.mark.parametrize("probe", [{"ready": {"tcp": 99, "timeout": "5s"}}, {"live": {"tcp": 99, "interval": "1s"}}])
@pytest.mark.parametrize("reborn", [False, True])
def test_after_a_probe_that_failed_the_proven_one_still_ends_what_hangs(virtual, probe, reborn):
    virtual.declare({"nav": {**WELL, **LIVE}})
    virtual.settle()
    later(virtual, 60)
    run = virtual.run_of("nav")
    virtual.sim.deaf.add(WRONG)
    virtual.declare({"nav": {**WELL, **LIVE, **probe}})
    virtual.wait(lambda: "its change failed" in statuses(virtual)["nav"].trouble)
    if reborn:
        virtual.sim.reborn(handed_on(virtual.sim.decision))
        later(virtual, 5)
    assert virtual.run_of("nav") == run
    assert statuses(virtual)["nav"].condition("Ready").status == "True"
    assert stands(virtual) == "failed"
    virtual.sim.hung.add(run)
    virtual.wait(lambda: virtual.run_of("nav") not in ("", run))


def test_readiness_is_kept_while_a_new_probe_is_tried(virtual):
    virtual.declare({"nav": {**WELL, "ready": {"tcp": 1}}, "tour": {**WELL, "needs": ["nav"]}})
    virtual.settle()
    later(virtual, 60)
    virtual.sim.deaf.add(WRONG)
    virtual.declare({"nav": {**WELL, "ready": {"tcp": 99, "timeout": "5s", "failures": 1}}, "tour": WELL})
    later(virtual, 1)
    while "its change failed" not in (status := statuses(virtual)["nav"]).trouble:
        assert (status.condition("Ready").status, status.sync) == ("True", "OutOfSync")
        assert status.trouble == "its new probe is being tried"
        later(virtual, 1)
    later(virtual, 30)
    status = statuses(virtual)["nav"]
    assert (status.condition("Ready").status, status.sync) == ("True", "OutOfSync")
    virtual.sim.deaf.clear()
    virtual.declare({"nav": {**WELL, "ready": {"tcp": 98}}, "tour": WELL})
    virtual.wait(lambda: statuses(virtual)["nav"].sync == "Synced")


def test_what_comes_back_is_asked_as_it_was_when_it_was_proven(virtual):
    virtual.declare({"nav": {**WELL, "ready": {"tcp": 1}, **LIVE}})
    virtual.settle()
    later(virtual, 60)
    before = virtual.container("nav").id
    virtual.sim.deaf.add(WRONG)
    virtual.declare({"nav": changed(1, ready={"tcp": 99, "timeout": "5s"})})
    virtual.wait(lambda: ids(virtual).get("nav", before) != before)
    virtual.wait(lambda: ids(virtual).get("nav") == before)
    later(virtual, 10)
    assert statuses(virtual)["nav"].condition("Ready").status == "True"
    run = virtual.run_of("nav")
    virtual.sim.hung.add(run)
    virtual.wait(lambda: virtual.run_of("nav") not in ("", run))


def test_a_file_that_a_signal_makes_a_program_read_is_good_after_a_bake(virtual):
    virtual.declare({"nav": {**WELL, "on_change": "signal SIGHUP", "update": {"bake": "20s"}}})
    catalog = virtual.sim.desired.catalog
    virtual.sim.desired = desire(catalog, contents={"nav": {"nav.conf": "1"}})
    virtual.settle()
    later(virtual, 60)
    run = virtual.run_of("nav")
    virtual.sim.desired = desire(replace(catalog, fingerprint="2"), contents={"nav": {"nav.conf": "2"}})
    later(virtual, 15)
    assert stands(virtual) == "baking"
    later(virtual, 10)
    assert stands(virtual) == "good"
    assert virtual.run_of("nav") == run


def test_a_run_goes_on_until_the_next_one_can_read_its_changed_file(virtual):
    """As with a new container: a service is not stopped for a change while it could not start again."""
    virtual.declare({"cam": {}, "nav": {**WELL, "needs": ["cam"]}})
    catalog = virtual.sim.desired.catalog
    virtual.sim.desired = desire(catalog, contents={"nav": {"nav.conf": "1"}})
    virtual.settle()
    run = virtual.run_of("nav")
    spoil(virtual, "cam", "start")
    virtual.sim.engine.kill(virtual.container("cam").id)
    virtual.sim.desired = desire(replace(catalog, fingerprint="2"), contents={"nav": {"nav.conf": "2"}})
    virtual.wait(lambda: virtual.waits("nav").startswith("cam waits"))
    later(virtual, 10)
    assert virtual.run_of("nav") == run
    virtual.sim.faults.bad.clear()
    virtual.wait(lambda: virtual.run_of("nav") not in ("", run))


@pytest.mark.parametrize(("digest", "same"), [("1", True), ("file:1", False)])
def test_no_signal_makes_a_program_read_a_single_mounted_file(virtual, digest, same):
    """Its container keeps the file that it was started with."""
    virtual.declare({"nav": {**WELL, "on_change": "signal SIGHUP"}})
    catalog = virtual.sim.desired.catalog
    virtual.sim.desired = desire(catalog, contents={"nav": {"nav.conf": digest, "maps": "1"}})
    virtual.settle()
    run = virtual.run_of("nav")
    virtual.sim.desired = desire(
        replace(catalog, fingerprint="2"), contents={"nav": {"nav.conf": f"{digest}2", "maps": "2"}}
    )
    later(virtual, 60)
    assert (virtual.run_of("nav") == run) is same
    assert stands(virtual) == "good"


# -- quarantine ------------------------------------------------------------------------------------------------


def test_several_editions_are_in_quarantine_also_for_the_next_rorg(virtual):
    virtual.declare({"nav": WELL})
    virtual.settle()
    good = virtual.container("nav").id
    for n in (1, 2):
        virtual.declare({"nav": changed(n)})
        spoil(virtual, "nav", "start")
        virtual.wait(lambda n=n: "its change failed" in virtual.waits("nav") and len(virtual.containers()) == 1)
    rejected = virtual.sim.decision.memory.of("nav").update.rejected
    virtual.sim.reborn(handed_on(virtual.sim.decision))
    assert virtual.sim.memory.of("nav").update.rejected == rejected not in ("", good)
    virtual.declare({"nav": WELL})
    virtual.settle()
    calls = len(virtual.sim.engine.calls)
    for n in (1, 2):
        virtual.declare({"nav": changed(n)})
        later(virtual, 30)
        assert "its change failed" in virtual.waits("nav")
    assert virtual.container("nav").id == good
    assert len(virtual.sim.engine.calls) == calls, "the loop does not fight the commit"
    virtual.sim.faults.bad.clear()
    retry(virtual, "nav")
    virtual.wait(lambda: virtual.container("nav").digest == virtual.sim.desired.digests["nav"])
    assert not virtual.sim.document.retries, "it is heard once"


@pytest.mark.parametrize("driver", [False, True])
def test_what_failed_does_not_run_again_when_what_was_proven_is_lost(virtual, driver):
    virtual.declare({"nav": {**WELL, "driver": driver}})
    virtual.settle()
    bad = changed(1, driver=driver, update={"when": "now"})
    virtual.declare({"nav": bad})
    digest = spoil(virtual, "nav", "exit")
    virtual.wait(lambda: "its change failed" in virtual.waits("nav") and len(virtual.containers()) == 1)
    virtual.kill("nav")
    virtual.drift("remove", "nav")
    later(virtual, 60)
    assert not virtual.containers()
    status = statuses(virtual)["nav"]
    assert (status.health, status.sync) == ("Degraded", "OutOfSync")
    assert "ended with exit code" in status.trouble
    assert "its previous container is gone" in virtual.waits("nav")
    assert "`rorg retry nav`" in virtual.waits("nav")
    virtual.sim.faults.bad.clear()
    retry(virtual, "nav")
    virtual.wait(lambda: statuses(virtual)["nav"].health == "Healthy")
    assert virtual.container("nav").digest == digest


@pytest.mark.parametrize("reborn", [False, True])
def test_a_retry_while_the_previous_container_starts_counts(virtual, reborn):
    virtual.declare({"nav": WELL})
    virtual.settle()
    later(virtual, 30)
    virtual.declare({"nav": changed(1)})
    digest = spoil(virtual, "nav", "exit")
    virtual.wait(lambda: virtual.sim.memory.of("nav").update.failed and len(ids(virtual)) == 1)
    assert len(virtual.containers()) == 2
    virtual.sim.faults.bad.clear()
    retry(virtual, "nav")
    if reborn:
        virtual.wait(lambda: not virtual.sim.document.retries)
        virtual.sim.reborn(handed_on(virtual.sim.decision))
    later(virtual, 60)
    assert [c.digest for c in virtual.containers()] == [digest]
    assert stands(virtual) == "good"


def test_quarantine_does_not_grow_without_bound():
    from rorg.core.update import MOST, Update

    update = Update()
    for n in range(100):
        update = replace(update, edition=str(n)).quarantine("no", 0.0)
    assert [*update.quarantined] == [str(n) for n in range(100 - MOST, 100)]


# -- sets ------------------------------------------------------------------------------------------------------

TOGETHER = {"update": {"atomic": "driving"}}


def test_of_a_set_all_go_back_where_one_fails_and_all_are_tried_with_its_mend(virtual):
    specs = {n: {**WELL, **TOGETHER} for n in ("nav", "map", "base")}
    virtual.declare({**specs, "cam": WELL})
    virtual.settle()
    before = ids(virtual)
    bad = {"nav": changed(1, **TOGETHER), "map": changed(1, **TOGETHER)}
    virtual.declare({**specs, **bad, "cam": changed(1)})
    spoil(virtual, "map")
    virtual.wait(lambda: "its change failed" in virtual.waits("map"))
    virtual.wait(lambda: len(virtual.containers()) == 4)
    found = ids(virtual)
    assert {n for n in before if found[n] != before[n]} == {"cam"}
    assert "it changes together with map, whose change failed" in virtual.waits("nav")
    calls = len(virtual.sim.engine.calls)
    virtual.sim.reborn(handed_on(virtual.sim.decision))
    later(virtual, 30)
    assert len(virtual.sim.engine.calls) == calls
    virtual.declare({**specs, **bad, "map": changed(2, **TOGETHER), "cam": changed(1)})
    virtual.settle()
    found = ids(virtual)
    assert {n for n in before if found[n] != before[n]} == {"cam", "nav", "map"}
    assert len(virtual.containers()) == 4


@pytest.mark.slow
@pytest.mark.parametrize("bad", [False, True])
def test_a_kill_of_rorg_at_any_moment_of_a_sets_change(virtual, bad):
    """rorg is killed before each of its actions in turn; the set changes as a whole, or goes back as a whole."""
    for kill_at in range(1, 14):
        virtual.sim = None
        virtual.declare({n: {**WELL, **TOGETHER} for n in ("nav", "map")})
        virtual.settle()
        before = ids(virtual)
        virtual.declare({n: changed(1, **TOGETHER) for n in ("nav", "map")})
        if bad:
            spoil(virtual, "map")
        done, end = len(virtual.sim.log) + kill_at, virtual.now() + 20
        virtual.sim.at(end, lambda: None)
        virtual.wait(lambda done=done, end=end: len(virtual.sim.log) >= done or virtual.now() >= end)
        virtual.sim.reborn(handed_on(virtual.sim.decision))
        virtual.wait(lambda: len(ids(virtual)) == len(virtual.containers()) == 2, 120)
        later(virtual, 10)
        found = ids(virtual)
        assert [found[n] == before[n] for n in ("nav", "map")] == [bad, bad], f"killed before action {kill_at}"
        own = virtual.sim.memory.of("nav").update.quarantined
        assert not own, f"killed before action {kill_at}: nothing is wrong with nav itself"


def test_who_leaves_its_set_waits_for_nobody_of_it(virtual):
    virtual.declare({n: {**WELL, **TOGETHER} for n in ("nav", "map")})
    virtual.settle()
    before = ids(virtual)
    virtual.declare({n: changed(1, **TOGETHER) for n in ("nav", "map")})
    spoil(virtual, "map", "start")
    virtual.wait(lambda: "its change failed" in virtual.waits("nav") and ids(virtual) == before)
    virtual.declare({"nav": changed(1), "map": changed(1, **TOGETHER)})
    virtual.wait(lambda: ids(virtual).get("nav", before["nav"]) != before["nav"])


def test_of_a_set_nobody_changes_over_where_one_cannot_be_made(virtual):
    virtual.declare({n: {**WELL, **TOGETHER} for n in ("nav", "map")})
    virtual.settle()
    before = ids(virtual)
    virtual.sim.faults.fail["create", "map"] = ["no such device"] * 3
    virtual.declare({n: changed(1, **TOGETHER) for n in ("nav", "map")})
    virtual.wait(lambda: "map, which changes together with it" in virtual.waits("nav"))
    assert ids(virtual) == before
    virtual.settle()
    assert not {*ids(virtual).values()} & {*before.values()}


def test_a_set_is_kept_until_all_of_it_have_stayed_well(virtual):
    virtual.declare({n: {**WELL, **TOGETHER} for n in ("nav", "map")})
    virtual.settle()
    before = ids(virtual)
    long = {"update": {"atomic": "driving", "bake": "1m"}}
    virtual.declare({"nav": changed(1, **TOGETHER), "map": changed(1, **long)})
    later(virtual, 40)
    assert len(virtual.containers()) == 4
    virtual.kill("map")
    virtual.wait(lambda: ids(virtual) == before)


def test_the_policy_lets_all_go_together_but_for_who_says_otherwise(virtual):
    policies = {"policy": {"updates": {"atomic": True, "bake": "3s"}}}
    apart = {"update": {"atomic": False}}
    names = {"nav": {}, "map": {"update": {"bake": "1s"}}, "cam": apart}
    virtual.declare({n: {**WELL, **more} for n, more in names.items()}, policies=policies)
    services = virtual.sim.desired.catalog.services
    assert {n: services[n].update.bake for n in names} == {"nav": 3.0, "map": 1.0, "cam": 3.0}
    assert [*virtual.sim.desired.sets.values()] == [("map", "nav")]


def test_a_policy_of_before_is_told_where_its_word_stands(tmp_path):
    from rorg.manifest.load import load

    write_tree(tmp_path, {"nav": {}}, policies={"policy": {"images": {"update": "when_ceased"}}})
    assert "`updates: {when: when_ceased}`" in str(load(tmp_path).errors[0])


# -- standing --------------------------------------------------------------------------------------------------


def test_a_state_of_the_manifests_is_good_after_its_bake(virtual):
    virtual.declare({"nav": {**WELL, "ready": {"delay": "3s"}, "update": {"bake": "10s"}}, "idle": {}})
    seen = []
    virtual.sim.at(30, lambda: None)
    virtual.wait(lambda: seen.append(stands(virtual)) or virtual.now() >= 30)
    assert list(dict.fromkeys(seen)) == ["applying", "baking", "good"]
    assert virtual.now() < 60
    virtual.kill("nav")
    later(virtual, 0.5)
    assert stands(virtual, good=True) == "good", "what ends later is not its doing"
    virtual.request("idle")
    later(virtual, 0.5)
    assert stands(virtual, good=True) == "good"


def test_what_was_idle_may_fail_later(virtual):
    virtual.declare({"nav": {}})
    virtual.request("nav")
    virtual.settle()
    virtual.release()
    virtual.settle()
    virtual.declare({"nav": {"container": {"environment": {"N": "1"}}}})
    spoil(virtual, "nav")
    later(virtual, 5)
    assert stands(virtual) == "untested", "its container is there, and nobody wants it"
    virtual.request("nav")
    virtual.wait(lambda: stands(virtual, good=True) == "failed")


def test_a_service_that_never_comes_up_makes_it_fail_without_a_way_back(virtual):
    virtual.declare({"nav": WELL})
    spoil(virtual, "nav")
    virtual.wait(lambda: stands(virtual) == "failed")
    decision = virtual.sim.decision
    assert standing(decision).reason.startswith("nav: ")


def test_what_waits_until_it_is_ceased_is_still_to_be_applied(virtual):
    later_on = {"update": {"when": "when_ceased"}}
    virtual.declare({"nav": {**WELL, **later_on}})
    virtual.settle()
    before = ids(virtual)
    virtual.declare({"nav": changed(1, **later_on)})
    later(virtual, 10)
    assert ids(virtual) == before
    assert stands(virtual) == "applying"
    virtual.kill("nav")
    virtual.wait(lambda: stands(virtual) == "good")
    assert ids(virtual) != before


# -- what the next rorg knows ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "probe",
    [
        None,
        Probe("tcp", "127.0.0.1:80", 5.0, 0.5, 3),
        Probe("delay", 2.5),
        Probe("ros_rate", ("/scan", "5"), graph="ros2:7"),
        Probe("all", "", parts=(Probe("tcp", 80), Probe("file", "/run/ready"))),
    ],
    ids=lambda probe: probe.kind if probe else "none",
)
def test_the_next_rorg_knows_the_probes_that_were_proven(probe):
    known = LastGood("v1:abc", probe, replace(probe, failures=1) if probe else None)
    saved = {"nav": saved_progress(Progress(update=Update(edition="now", last_good=known)), None, "boot")}
    assert remembered(json.loads(json.dumps(saved)), 0.0, "boot").of("nav").update.last_good == known


def test_malformed_probes_count_as_unknown():
    sound = saved_progress(Progress(update=Update(last_good=LastGood("v1:abc", Probe("tcp", 80), None))), None, "boot")
    for wrong in ("x", 5, [], {"digest": "v1:abc"}, {**sound["last_good"], "ready": {**PROBE, "target": {}}}):
        assert remembered({"nav": {**sound, "last_good": wrong}}, 0.0, "boot").of("nav").update.last_good is None


PROBE = asdict(Probe("tcp", 80))
