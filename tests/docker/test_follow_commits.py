"""A robot follows a repository: after each commit that is pushed it is in the state that the commit asks for, or in the
last good one, with the reason on record; and every state comes back as it was (paper, Section III-C and Table I)."""

from __future__ import annotations

import json
import random
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import commands
import fuzzing
import pytest
from common import wait_for
from robots import Daemon, write_tree

GOOD = ("change", "config", "remove", "rename", "add")
BAD = {
    "image": {"image": "nosuch-image:1"},
    "never ready": {"ready": {"exec": "false", "timeout": "500ms"}},
    "crash": {"command": ["sh", "-c", "exit 3"]},
}
KINDS = (*GOOD, *BAD, "yaml")


def git(folder: Path, *words: str) -> str:
    who = ("-c", "user.name=Ada", "-c", "user.email=ada@lab")
    return subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True, text=True).stdout.strip()


@dataclass
class Lab:
    """A repository, a clone of it, and a robot that follows it. `now` is what a commit says of each service: its
    version; `kept` the last version of each that came up."""

    robot: object
    folder: Path
    chance: random.Random
    now: dict[str, int] = field(default_factory=lambda: {f"s{n}": 0 for n in range(6)})
    kept: dict[str, int] = field(default_factory=dict)
    config: dict[str, int] = field(default_factory=lambda: {f"s{n}": 0 for n in range(6)})
    bad: dict[str, str] = field(default_factory=dict)
    torn: bool = False
    names: int = 6

    def begin(self) -> None:
        git(self.folder, "init", "-q", "--bare", "-b", "main", "robot.git")
        git(self.folder, "clone", "-q", "robot.git", "clone")
        self.push("the first")
        self.daemon = Following(self)
        self.daemon.start()

    @property
    def clone(self) -> Path:
        return self.folder / "clone"

    def write(self) -> None:
        tree = self.clone / "robot"
        services = {}
        for name, version in self.now.items():
            (tree / "config").mkdir(parents=True, exist_ok=True)
            (tree / "config" / name).write_text(f"{self.config[name]}\n")
            container = {"environment": {"VERSION": str(version)}, "volumes": [f"../config/{name}:/config:ro"]}
            services[name] = {"always_on": True, "container": container, **BAD.get(self.bad.get(name, ""), {})}
        write_tree(tree, services, policies={"robot": {"removals": "auto", "updates": {"bake": "1s"}}})
        torn = tree / "services" / "torn.yaml"
        torn.write_text("apiVersion: rorg/v1\nkind: [Service\n") if self.torn else torn.unlink(missing_ok=True)

    def push(self, message: str) -> str:
        self.write()
        git(self.clone, "add", "-A")
        git(self.clone, "commit", "-q", "--allow-empty", "-m", message)
        git(self.clone, "push", "-q", "origin", "HEAD:main")
        return git(self.clone, "rev-parse", "HEAD")

    def step(self, kind: str) -> str:
        """The next commit: what was bad is mended, and one thing is done."""
        self.bad, self.torn = {}, kind == "yaml"
        name = self.chance.choice(sorted(self.now))
        if kind in ("change", *BAD):
            self.now[name] += 1
        if kind in BAD:
            self.bad = {name: kind}
        if kind == "config":
            self.config[name] += 1
        if kind == "rename" or (kind == "remove" and len(self.now) > 3):
            self.now.pop(name)
        if kind in ("rename", "add"):
            self.names += 1
            self.now[f"s{self.names}"], self.config[f"s{self.names}"] = 0, 0
        return self.push(f"{kind} {name}")

    def expected(self) -> dict[str, int]:
        """The version of each service that is to run."""
        if not self.torn:
            self.kept = {n: self.kept[n] if n in self.bad else v for n, v in self.now.items()}
        return self.kept

    def running(self) -> dict[str, dict]:
        """Each service that runs, as the engine shows it."""
        api = self.robot.engine.api()
        return {c.service: api.inspect_container(c.id) for c in self.robot.containers() if c.state == "running"}

    def versions(self) -> dict[str, int]:
        return {
            name: int(next(v for v in found["Config"]["Env"] if v.startswith("VERSION=")).removeprefix("VERSION="))
            for name, found in self.running().items()
        }

    def read(self) -> dict[str, int]:
        """What each service's configuration says inside."""
        found = {c.service: c.id for c in self.robot.containers() if c.state == "running"}
        words = ["python3", "-S", "-c", "print(open('/config').read())"]
        return {n: int(self.robot.engine.exec(i, words, 30.0)[1].decode()) for n, i in found.items()}

    def rorg(self, *words: str, code: int = 0) -> str:
        return commands.rorg(*words, "--state-dir", str(self.robot.state.path), code=code, cwd=self.clone).stdout

    def settled(self, commit: str) -> dict:
        """The revision of a commit, once it is known what became of it."""
        revision: dict = {}

        def known() -> bool:
            nonlocal revision
            newest = json.loads(self.rorg("history", "-n", "1", "-o", "json"))
            revision = newest[0] if newest else {}
            return commit.startswith(revision.get("commit", "-")) and revision["standing"] not in ("applying", "baking")

        wait_for(known, 60, f"what became of {commit}")
        return json.loads(self.rorg("history", "show", str(revision["number"]), "-o", "json"))


class Following(Daemon):
    """`rorg run` of a repository."""

    def __init__(self, lab: Lab) -> None:
        super().__init__(lab.robot)
        self.lab = lab

    def start(self) -> None:
        self.starts += 1
        place = ["--state-dir", str(self.robot.state.path), "--engine", "docker"]
        source = ["--git", f"{self.lab.folder / 'robot.git'}@main", "--path", "robot", "--poll", "1s"]
        with (self.robot.state.path.parent / "run.log").open("ab") as log:
            self.process = commands.Forked(["run", *source, *place], stdout=log, stderr=log)


@pytest.fixture
def lab(docker_robot, tmp_path) -> Iterator[Lab]:
    found = Lab(docker_robot, tmp_path / "lab", random.Random(f"commits {fuzzing.SEED}"))
    found.folder.mkdir()
    found.begin()
    yield found
    found.daemon.stop()


def shown(found: dict) -> dict:
    """What the engine tells of a container, but for which one it is."""
    config, host = found["Config"], found["HostConfig"]
    return {
        "image": found["Image"],
        "name": found["Name"],
        "config": {k: config[k] for k in ("Cmd", "Env", "Image", "User", "WorkingDir", "Entrypoint")},
        "host": host,
        "spec": config["Labels"]["rorg.io/spec"],
        "mounts": sorted((m["Source"], m["Destination"], m["RW"]) for m in found["Mounts"]),
    }


def test_every_commit_is_in_force_or_the_last_good_state_is_and_every_state_comes_back(lab):
    commit = git(lab.clone, "rev-parse", "HEAD")
    good = {}
    for number in range(fuzzing.count("commits", 10)):
        kind = KINDS[number % len(KINDS)] if number < len(KINDS) else lab.chance.choice(KINDS)
        revision = lab.settled(commit)
        assert revision["standing"] == ("refused" if lab.torn else "failed" if lab.bad else "good"), revision
        assert all(name in revision["reason"] for name in lab.bad), revision["reason"]
        assert not lab.torn or "torn.yaml" in "".join(revision["errors"])
        wait_for(lambda: lab.versions() == lab.expected(), 60, f"{lab.expected()} after {kind}, not {lab.versions()}")
        assert lab.read() == {n: lab.config[n] for n in lab.now} or lab.torn
        if revision["standing"] == "good":
            good[revision["number"]] = {name: shown(found) for name, found in lab.running().items()}
            for name, found in good[revision["number"]].items():
                made = revision["services"][name]
                assert (made["digest"], made["image_id"]) == (found["spec"], found["image"])
        commit = lab.step(kind)
    lab.settled(commit)
    numbers = sorted(good)
    lab.chance.shuffle(numbers)
    for number in numbers:
        printed = lab.rorg("rollback", str(number), "--print")
        subprocess.run(["sh", "-ec", printed], cwd=lab.clone, check=True, capture_output=True)
        git(lab.clone, "push", "-q", "origin", "HEAD:main")
        revision = lab.settled(git(lab.clone, "rev-parse", "HEAD"))
        assert revision["standing"] == "good", revision
        assert {name: shown(found) for name, found in lab.running().items()} == good[number]
