"""A command does the same with a running rorg and without one: what it says, its exit code, and the requests file."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import commands
import pytest
from command_samples import SAMPLES
from common import wait_for
from robots import RealRobot

from rorg.model.catalog import Hold, Request
from rorg.store.requests_document import RequestsDocument

pytestmark = pytest.mark.slow  # each command twice, with and without a running rorg

SERVICES = {
    "roscore": {},
    "navigation": {"needs": ["roscore"]},
    "mission": {"may_request": ["arm"], "always_on": True},
    "arm": {"driver": {"groups": ["dialout"]}, "exclusive": ["hand"]},
    "gripper": {"exclusive": ["hand"]},
    "mapper": {"conflicts": ["navigation"]},
    "big": {"resources": {"memory": "64Gi"}},
    "stub": {"type": "meta"},
}
KINDS = {
    "groups": {"driving": {"services": ["navigation", "roscore"]}, "nothing-real": {"services": ["stub"]}},
    "requests": {"always": {"requester": "mission", "services": ["roscore"]}},
    "policies": {"policy": {"budget": {"memory": "8Gi", "over": "refuse"}}},
}
COMMANDS = [line for sample in reversed(SAMPLES.values()) for line in sample.alike]
"""In this order, `describe` comes after the changes whose events it shows."""
NOBODY = "no rorg runs here; it takes effect at the next `rorg run` or `rorg apply`\n"
"""What is said to whoever changes something that nobody does now."""
NO_LOOP = r"no rorg runs on \S+: this is the state of .*\n"
"""What stands above a listing of services that nobody keeps."""


class Commands:
    """Runs command lines on one state directory."""

    def __init__(self, state: Path) -> None:
        self.environment = {**os.environ, "RORG_STATE_DIR": str(state), "RORG_ENGINE": "process", "TERM": "dumb"}

    def __call__(self, *words: str) -> dict:
        done = commands.run([*words], self.environment)
        return {"code": done.returncode, "out": done.stdout, "err": done.stderr}


class Twice:
    """A robot whose services stand still: it is suspended. What commands did is undone after each."""

    def __init__(self, folder: Path) -> None:
        self.robot = RealRobot(folder, "process", None, with_server=True)
        self.robot.declare(SERVICES, **KINDS)
        self.commands = Commands(self.robot.state.path)
        self.robot.wait(lambda: "mission" in self.robot.active())
        self.robot.request("navigation", id="tour", reason="a visitor")
        self.robot.request("arm", id="shared", by="mission")
        self.robot.request("roscore", id="shared")
        self.robot.wait(lambda: self.robot.active() >= {"navigation", "roscore", "arm", "mission"})
        self.robot.settle()
        # Later it would settle between two commands that are compared.
        self.robot.wait(lambda: self.commands("history", "-o", "json")["out"].count('"good"') == 1)
        before = self.robot.file.document
        self.before = replace(
            before,
            holds={"mapper": Hold(4102444800.0, "kept")},
            suspended=Hold(4102444800.0, "so that all stands still"),
        )

    def begin(self) -> None:
        self.robot.file.change(lambda _: self.before)
        if self.robot.loop:
            reached = self.robot.loop.generations.changed()
            self.robot.loop.wakes.requests_changed()
            wait_for(lambda: self.robot.loop.generations.reached(reached))

    def once(self, words: list[str]) -> dict:
        self.begin()
        told = self.commands(*words)
        self.robot.file.read()
        said = re.sub(NO_LOOP, "", told["err"].replace(NOBODY, ""))
        out = re.sub(r" +\d+[smhd] +", " AGE ", told["out"])
        return {**told, "out": out, "err": said, "file": normal(self.robot.file.document, self.before)}

    def close(self) -> None:
        self.robot.close()


def normal(document: RequestsDocument, before: RequestsDocument) -> RequestsDocument:
    """Without the times at which it was made."""

    def hold(found: Hold | None, was: Hold | None) -> Hold | None:
        return (
            found if found is None or found == was else replace(found, until=round(found.until - 4e9, -9), uptime=0.0)
        )

    return replace(
        document,
        requests=tuple(replace(r, renewed="", where=Request("", "", ()).where) for r in document.requests),
        restarts=dict.fromkeys(document.restarts, "a time"),
        holds={n: hold(h, before.holds.get(n)) for n, h in document.holds.items()},
        suspended=hold(document.suspended, before.suspended),
    )


def words_of(line: str) -> list[str]:
    return [w.strip("'") for w in re.findall(r"'[^']*'|\S+", line)]


@pytest.fixture(scope="module")
def twice(tmp_path_factory):
    """What each command line came to, with a running rorg and without."""
    found = Twice(tmp_path_factory.mktemp("robot"))
    try:
        served = {line: found.once(words_of(line)) for line in COMMANDS}
        found.begin()
        found.robot.stop()
        alone = {line: found.once(words_of(line)) for line in COMMANDS}
        found.begin()
        yield found, served, alone
    finally:
        found.close()


@pytest.mark.slow
@pytest.mark.parametrize("line", COMMANDS, ids=lambda line: line[:60])
def test_a_command_does_the_same_with_a_running_rorg_and_without(twice, line):
    _, served, alone = twice
    assert alone[line] == served[line]
    assert "internal error" not in alone[line]["err"]


@pytest.mark.parametrize(
    "line", ["request gripper --wait", "restart navigation --wait", "wait navigation", "wait nosuch"]
)
def test_what_would_wait_for_nobody_exits_3_and_changes_nothing(twice, line):
    found, _, _ = twice
    told = found.once(words_of(line))
    assert told["code"] == 3
    assert "no rorg runs" in told["err"]
    assert not told["out"]
    assert told["file"] == normal(found.before, found.before)
