"""An edit ends or replaces no driver in use before a person confirms it; a driver that fails is mended at once."""

from __future__ import annotations

import shlex

import pytest
from robots import WORK, RealRobot, write_tree
from rolled_back import git, rorg, stands

POLICY = {"robot": {"updates": {"bake": "100ms"}}}


class Driven(RealRobot):
    """A robot in git whose `wheels` are a driver that somebody has requested, with a script that they mount."""

    def begin(self) -> None:
        (self.tree.parent / "manifests").symlink_to(self.tree)
        (self.tree / "services/wheels").mkdir(parents=True)
        git(self, "init", "--quiet")
        self.script = self.tree / "services/wheels/start.sh"
        self.script.write_text(f"exec {shlex.join(WORK)}")
        place = "/conf/start.sh" if self.kind == "docker" else self.script
        self.wheels = {"driver": True, "mounts": ["./wheels:/conf"], "command": ["sh", str(place)]}
        self.first = self.commit()
        self.start()
        self.request("wheels")
        stands(self, self.first, "good")
        self.run = self.run_of("wheels")

    def save(self, **more) -> None:
        write_tree(self.tree, {"wheels": {**self.wheels, **more}}, policies=POLICY)

    def commit(self, **more) -> str:
        self.save(**more)
        git(self, "add", ".")
        git(self, "commit", "--quiet", "--message", "next")
        return git(self, "rev-parse", "HEAD")

    def waits_for_a_person(self) -> None:
        """The loop has read the edit, and leaves the driver as it is."""
        self.wait(lambda: "wheels is in use; `rorg apply` confirms the change" in self.waits("wheels"))
        assert self.run_of("wheels") == self.run

    def say(self, *words: str, code: int = 0) -> str:
        return rorg(self, *words, code=code, RORG_ENGINE=self.kind)

    def moves_on(self) -> None:
        """Another run of the wheels."""
        self.wait(lambda: "wheels" in self.active() and self.run_of("wheels") != self.run)


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.docker)])
def robot(request, tmp_path):
    host = request.getfixturevalue("dockerd").host if request.param == "docker" else None
    found = Driven(tmp_path, request.param, host, with_server=True)
    found.begin()
    yield found
    found.close()


@pytest.mark.slow
@pytest.mark.parametrize("word", ["apply", "restart"])
def test_an_edit_waits_until_a_person_confirms_it(robot, word):
    robot.save(container={"environment": {"N": "2"}})
    robot.waits_for_a_person()
    assert "wheels is in use" in robot.say("diff", code=1)
    assert "wheels is in use" in robot.say("why", "wheels")
    robot.wait(lambda: "wheels is in use" in robot.say("get"))
    said = robot.say(*("apply",) if word == "apply" else ("restart", "wheels"), code=5)
    assert "wheels" in said
    assert "no terminal" in said
    robot.waits_for_a_person()
    robot.say(*("apply",) if word == "apply" else ("restart", "wheels"), "--yes", "--wait")
    robot.moves_on()
    robot.wait(robot.quiet)
    assert "No differences" in robot.say("diff")


@pytest.mark.slow
def test_an_edit_of_a_mounted_file_waits_too_and_takes_effect_once_it_is_idle(robot):
    robot.script.write_text(f"# faster\nexec {shlex.join(WORK)}")
    robot.waits_for_a_person()
    robot.release()
    robot.wait(lambda: "wheels" not in robot.active())
    robot.request("wheels")
    robot.moves_on()
    robot.wait(robot.quiet)
    assert not robot.waits("wheels")


@pytest.mark.slow
def test_a_rollback_confirms_it(robot):
    second = robot.commit(container={"environment": {"N": "2"}})
    robot.waits_for_a_person()
    robot.say("apply", "--yes", "--wait")
    stands(robot, second, "good")
    robot.run = robot.run_of("wheels")
    robot.say("rollback", "1", "--yes", "--wait")
    robot.moves_on()


@pytest.mark.slow
def test_one_that_fails_is_mended_without_a_question(robot):
    """Its program has ended again and again, and waits for its next start."""
    for ends in range(1, 5):
        robot.wait(lambda: "wheels" in robot.active())
        robot.kill("wheels")
        robot.wait(lambda n=ends: robot.loop.decision.memory.of("wheels").exits == n)
    mended = robot.commit(command=["sh", "-c", f"echo up; exec {shlex.join(WORK)}"])
    robot.moves_on()
    stands(robot, mended, "good")


def test_a_removed_manifest_of_one_that_is_always_on_waits_too(robot):
    robot.save(always_on=True)
    robot.wait(lambda: robot.loop.tree.desired.catalog.services["wheels"].always_on)
    robot.release()
    robot.wait(lambda: not robot.requests())
    robot.wait(robot.quiet)
    write_tree(robot.tree, {"other": {}}, policies=POLICY)
    robot.wait(lambda: "wheels" in robot.loop.decision.situation.withheld)
    assert "it is a driver in use; confirm it with `rorg apply`" in robot.say("diff", code=1)
    assert robot.run_of("wheels") == robot.run
    robot.say("apply", "--yes")
    robot.wait(lambda: "wheels" not in robot.active())
