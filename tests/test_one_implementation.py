"""A command does the same with a running rorg and without one: what it says, its exit code, and the requests file."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import commands
import pytest
from conftest import wait_for
from robots import RealRobot

from rorg.model.catalog import Hold, Request
from rorg.store.requests_document import RequestsDocument

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
LONG = "x" * 65
COMMANDS = [
    "request navigation",
    "request navigation roscore navigation --id tour --reason visitor --priority 70",
    "request driving --id tour",
    "request roscore --id other --ttl 10s",
    "request roscore --id other --ttl 1500ms",
    "request roscore --ttl 0s",
    "request roscore --ttl soon",
    "request roscore --ttl 9999999d",
    "request roscore --priority 101",
    "request",
    "request navigatoin",
    "request navigation nosuch driving neither",
    "request ''",
    f"request {LONG}",
    "request nav/igation",
    "request driving --id 'bad id'",
    f"request driving --id {LONG}",
    f"request roscore --reason {'y' * 501}",
    "request roscore --as mission",
    "request roscore --as gripper",
    "request roscore --as stub",
    "request roscore --as nobody",
    "request roscore --as driving",
    f"request roscore --as {LONG}",
    "request gripper arm",
    "request mapper",
    "request mapper --id navigation",
    "request mapper --id tour",
    "request big",
    "request big nosuch",
    "release tour",
    "release nosuch",
    "release shared",
    "release shared --as mission",
    "release shared --as nobody",
    "release always",
    "release 'bad id'",
    "restart navigation",
    "restart driving",
    "restart mission",
    "restart arm",
    "restart arm --yes",
    "restart gripper",
    "restart developer",
    "restart stub --yes",
    "restart nothing-real",
    "restart nosuch",
    "restart na/vigation",
    "restart ''",
    "retry navigation",
    "retry navigation arm",
    "retry developer",
    "retry nosuch",
    "retry ''",
    "hold navigation --for 10m --reason why-not",
    "hold driving gripper navigation --for 1h30m",
    "hold gripper nosuch --for 10m",
    "hold gripper developer --for 10m",
    "hold nothing-real --for 10m",
    "hold navigation",
    "hold navigation --for 0s",
    "hold navigation --for 300.3ms",
    f"hold navigation --for 10m --reason {'y' * 501}",
    "hold mapper --end",
    "hold mapper gripper --end",
    "hold nosuch --end",
    "hold ''  --for 10m",
    "suspend --for 10m --reason maintenance",
    "suspend",
    "suspend --for 0s",
    "suspend --for 20y",
    f"suspend --for 10m --reason {'y' * 501}",
    "suspend --end",
    "why navigation",
    "why navigation -o json",
    "why roscore",
    "why driving -o yaml",
    "why gripper",
    "why stub",
    "why developer",
    "why nosuch",
    "why ''",
    "wait",
    "wait navigation --timeout soon",
    "get requests",
    "get requests -o json",
    "get requests tour -o yaml",
    "get requests nosuch",
    "get groups -o json",
    "get groups nosuch",
    "get images",
    "get services",
    "get services -o name",
    "get gripper arm -o json",
    "get driving mapper --sort-by priority",
    "get --group driving -l nothing=here",
    "get navigatoin",
    "get --sort-by size",
    "get policies -o json",
    "get profiles nosuch",
    "describe gripper",
    "describe nosuch",
    "get services nosuch",
    "get service driving",
    "get neither",
    "history show 1",
    "history show 1 -o json",
    "history show nosuch",
    "history diff 1 1",
    "history diff 1 99",
    "history -n 1 -o yaml",
    "timeline nosuch",
    "events --until 2020-01-01",
]
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
        return found if found is None or found == was else replace(found, until=round(found.until - 4e9, -9))

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
