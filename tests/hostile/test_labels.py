"""Containers that carry our label and say anything in the others: no pass is broken by them, and what cannot be read of
them is told."""

from __future__ import annotations

import json
from collections.abc import Mapping

import pytest
from fuzzing import Case, fuzz
from mutations import VALUES, WORDS, mutated_text, mutated_value
from robots import BASE_IMAGE, WORK, RealRobot, write_tree

from rorg.core.digest import Rules, canonical, labels, unreadable
from rorg.core.observed import LABEL_DECLARED, LABEL_OWNER, LABEL_RULES, LABEL_SERVICE, Container, from_labels
from rorg.manifest.load import load_or_raise
from rorg.model.probe import Probe
from rorg.tools.sim.robot import SimRobot

SERVICES = {
    "arm": {"always_on": True, "exclusive": ["gripper"], "interlock": {"file": "/run/estop"}},
    "camera": {"always_on": True, "conflicts": ["lidar"]},
    "lidar": {},
}
SPEC = {
    "image": "x",
    "command": ["x"],
    "volumes": ["/a:/b:ro"],
    "ports": ["80:80"],
    "environment": {"A": "b"},
    "cpus": 1,
}
RULES = Rules(Probe("file", "/run/estop"), {"gripper": 1}, ("camera",))


def spoilt(case: Case, service: str) -> dict[str, str]:
    """Labels of a container of that service, one or two of them otherwise."""
    found, chance = dict(labels("sim", service, SPEC, "v1:" + "0" * 32, RULES, previous="f" * 64)), case.chance
    for label in chance.sample(sorted(set(found) - {LABEL_OWNER}), chance.choice((1, 1, 2))):
        how = chance.random()
        if how < 0.15:
            del found[label]
        elif how < 0.4:
            found[label] = chance.choice((*WORDS, *map(str, VALUES)))
        elif how < 0.7 and label in (LABEL_DECLARED, LABEL_RULES):
            found[label] = json.dumps(mutated_value(json.loads(found[label]), chance))
        else:
            found[label] = mutated_text(found[label], chance)
    case.text = json.dumps(found)
    return found


@pytest.mark.fuzz
def test_no_label_breaks_a_pass(tmp_path):
    catalog = load_or_raise(write_tree(tmp_path, SERVICES))

    def attempt(case: Case) -> None:
        robot = SimRobot(catalog)
        for name in case.chance.sample(("arm", "camera", "lidar", "unknown"), 2):
            made = spoilt(case, name)
            container = robot.engine.create(f"{name}.old", SPEC, {LABEL_SERVICE: "", **made})
            if case.chance.random() < 0.7:
                robot.engine.start(container)
        for _ in range(12):
            robot.step()
        nameless = [c.id for c in robot.engine.list() if not c.service]
        assert all(unreadable(robot.engine.inspect(c)) for c in nameless)
        assert not robot.decision.violations, robot.decision.violations

    fuzz("labels", 30, attempt)


@pytest.mark.parametrize("service", ["", " ", "../x", "a/b", "\0", "x" * 200, "ä", "-x", "a\nb"])
def test_what_names_no_service_is_nobodys(service):
    assert from_labels({LABEL_SERVICE: service})["service"] == ""


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({LABEL_SERVICE: "../x"}, LABEL_SERVICE),
        ({LABEL_RULES: "["}, LABEL_RULES),
        ({LABEL_RULES: canonical({"interlock": ["exec", "x", 1], "exclusive": {}, "conflicts": []})}, LABEL_RULES),
        ({LABEL_DECLARED: "[1]"}, LABEL_DECLARED),
        ({}, ""),
    ],
)
def test_the_label_that_cannot_be_read_is_named(changed: Mapping[str, str], said: str):
    made = from_labels({**labels("me", "arm", SPEC, "v1:x", RULES), **changed})
    found = unreadable(Container("a" * 64, "arm", state="running", **made))
    assert said in found if said else not found


def test_a_container_that_cannot_be_read_is_told_and_left_alone(tmp_path):
    robot = RealRobot(tmp_path, "process", None)
    try:
        robot.declare({"camera": {"always_on": True}})
        robot.wait(lambda: robot.active() == {"camera"})
        mine = {LABEL_OWNER: robot.engine.owner}
        stray = robot.engine.create("stray", {"image": BASE_IMAGE, "command": WORK}, {**mine, LABEL_SERVICE: "../x"})
        spoilt = robot.engine.create("other", {"image": BASE_IMAGE, "command": WORK}, {**mine, LABEL_SERVICE: "other"})
        (robot.engine.records.folder(spoilt) / "record.json").write_text('{"id": 5}')
        robot.loop.observer.sync()
        robot.wait(
            lambda: all(any(c[:12] in line and "left alone" in line for line in robot.log()) for c in (stray, spoilt))
        )
        robot.kill("camera")
        robot.wait(lambda: any("unexpected exit" in line for line in robot.log()) and robot.active() == {"camera"})
        assert {c.id for c in robot.containers()} >= {stray, spoilt}
    finally:
        robot.close()
