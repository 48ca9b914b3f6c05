"""Probes of several parts: a service is ready, or alive, when all of them hold."""

from __future__ import annotations

import json
import time
from dataclasses import replace

from common import wait_for
from robots import VirtualRobot, write_tree

from rorg.core.desired import desire
from rorg.core.memory import ProbeResult, together
from rorg.core.schedule import Target
from rorg.core.status import ros_nodes
from rorg.manifest.effective import effective
from rorg.manifest.load import load, load_or_raise
from rorg.model.former import Kept
from rorg.model.probe import Probe
from rorg.probes.answer import YES, no
from rorg.probes.prober import Prober
from rorg.store.last_good import read_kept, write_kept
from rorg.tools.compose.writer_notes import SERVICE, condition

PARTS = [{"ros_node": "/planner", "interval": "2s"}, {"tcp": 9090}, {"exec": "true"}]
NODE, PORT = Probe("ros_node", "/planner"), Probe("tcp", "127.0.0.1:9090")


def both(**more) -> Probe:
    return Probe("all", "", parts=(replace(NODE, **more), replace(PORT, **more)), **more)


def of(folder, **spec):
    return load_or_raise(write_tree(folder, {"planner": {"image": "planner:1", **spec}})).services["planner"]


def test_each_part_has_its_own_form_and_interval(tmp_path):
    ready = of(tmp_path, ready={"all": PARTS, "timeout": "20s", "failures": 2}).ready
    assert [(p.kind, p.interval) for p in ready.parts] == [("ros_node", 2.0), ("tcp", 0.25), ("exec", 1.0)]
    assert {(p.timeout, p.failures) for p in (ready, *ready.parts)} == {(20.0, 2)}
    assert (ready.interval, ready.parts[0].graph) == (0.25, "http://localhost:11311")
    assert str(ready) == "ros_node /planner and tcp 127.0.0.1:9090 and exec true"


def test_the_interval_of_the_whole_is_that_of_parts_without_one(tmp_path):
    live = of(tmp_path, live={"all": PARTS, "interval": "7s"}).live
    assert [p.interval for p in live.parts] == [2.0, 7.0, 7.0]
    assert live.failures == 3


def test_a_ready_service_is_asked_once_a_second_at_the_most():
    whole = replace(both(), parts=(replace(NODE, interval=5.0), PORT))
    assert [t.every for t in Target(whole, "run", 0.25).parts()] == [5.0, 0.25]
    assert [t.every for t in Target(whole, "run", 1.0).parts()] == [5.0, 1.0]


def test_the_whole_holds_when_all_parts_do_and_names_those_that_do_not():
    yes = ProbeResult("run", True, 4.0, probe=both())
    missing = ProbeResult("run", False, 5.0, "/planner is not registered", 2, both())
    assert together(both(), [yes, replace(yes, at=3.0)]) == replace(yes, at=3.0)
    assert together(both(), [missing, yes]) == replace(missing, at=4.0)
    refused = replace(missing, message="tcp 127.0.0.1:9090: Connection refused", failures=1)
    said = together(both(), [missing, refused])
    assert (said.message, said.failures) == ("/planner is not registered; tcp 127.0.0.1:9090: Connection refused", 2)
    assert together(both(), [None, yes]).message == "ros_node /planner has not answered yet"
    assert together(both(), [None, None]) is None


def test_a_part_that_takes_its_time_holds_up_no_other():
    answered = []

    def ask(key, target):
        if target.part == 0:
            wait_for(lambda: len(answered) >= 5)
            return YES
        answered.append(target.probe)
        return no("it is not there")

    prober = Prober(time.monotonic, lambda: None, ask)
    prober.start()
    prober.watch({("planner", "ready"): Target(both(interval=0.02), "run", 0.02)})
    wait_for(lambda: ("planner", "ready") in prober.results())
    assert prober.results()["planner", "ready"].message.endswith("has not answered yet; it is not there")
    wait_for(lambda: prober.results()["planner", "ready"].message == "it is not there")
    before = prober.results()["planner", "ready"]
    assert before.failures >= 5
    prober.watch({("planner", "ready"): Target(both(interval=0.02), "another run", 0.02)})
    wait_for(lambda: prober.results().get(("planner", "ready"), before).incarnation == "another run")
    prober.stop()


def test_one_question_is_what_it_was_before_there_were_parts(tmp_path):
    """These are of the version that knew no parts: otherwise its update would put every service on trial again."""
    spec = {"image": "robot:1", "command": ["serve"], "ready": {"tcp": 9090, "timeout": "20s"}}
    catalog = load_or_raise(write_tree(tmp_path, {"server": spec}))
    assert catalog.fingerprint == "906aa556777a6c1e"
    assert desire(catalog).editions == {"server": "v1:32a5cc9b2bd91cc180baffc06a6c4917"}


def test_parts_are_told_from_each_other(tmp_path):
    one = load_or_raise(write_tree(tmp_path, {"planner": {"image": "s:1", "ready": {"all": PARTS[:1]}}}))
    two = load_or_raise(write_tree(tmp_path, {"planner": {"image": "s:1", "ready": {"all": PARTS[:2]}}}))
    assert one.fingerprint != two.fingerprint
    assert desire(one).editions != desire(two).editions
    assert desire(one).digests == desire(two).digests, "the container is the same"


def test_what_was_declared_last_is_read_again_with_its_parts(tmp_path):
    catalog = load_or_raise(write_tree(tmp_path / "tree", {"planner": {"image": "s:1", "ready": {"all": PARTS}}}))
    write_kept(tmp_path, Kept(catalog, {}))
    assert read_kept(tmp_path).catalog.services["planner"].ready == catalog.services["planner"].ready


def test_explain_and_status_know_the_parts(tmp_path):
    service = of(tmp_path, ready={"all": PARTS})
    values = {v.field: v for v in effective(tmp_path, "planner")}
    assert values["ready.all"].value == [{"ros_node": "/planner", "interval": 2.0}, {"tcp": "9090"}, {"exec": ["true"]}]
    assert json.dumps(values["ready.all"].as_json())
    assert "ready.interval" not in values
    assert ros_nodes(service) == ("/planner",)


def test_checks_look_at_every_part(tmp_path):
    parts = [{"tcp": 9090}, {"exec": "rosnode ping -c 1 /a"}]
    tree = write_tree(tmp_path, {"one": {"image": "a:1", "ready": {"all": parts}}, "two": {"ready": {"tcp": 9090}}})
    found = {(d.code, d.where.line) for d in load(tree).diagnostics}
    lines = (tree / "services/one.yaml").read_text().splitlines()
    asked = next(n for n, line in enumerate(lines, 1) if "rosnode" in line)
    assert ("costly-probe", asked) in found
    assert "port-probed-twice" in {code for code, _ in found}


def test_compose_is_told_what_it_does_not_wait_for(tmp_path):
    service = of(tmp_path, ready={"all": [{"engine": "healthy"}, {"tcp": 9090}]})
    assert condition(service.ready) == "service_healthy"
    said = dict(SERVICE)["ready"](service)
    assert said == "tcp 127.0.0.1:9090; Compose waits only for the healthcheck"


def test_a_virtual_robot_waits_for_parts_as_for_one(tmp_path):
    robot = VirtualRobot(tmp_path)
    robot.declare({"planner": {"ready": {"all": [{"tcp": 1}, {"tcp": 2}]}}, "arm": {"needs": ["planner"]}})
    robot.request("arm")
    robot.wait(lambda: "arm" in robot.active())
