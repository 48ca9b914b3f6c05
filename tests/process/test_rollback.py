"""`rorg rollback` and `rorg restore`: an earlier state of the manifests comes back by a commit, beside a running rorg
and without one."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import commands
import pytest
from common import wait_for
from robots import RealRobot, write_tree
from rolled_back import ANN, git, revisions, rorg, stands

from rorg.cli.goals import Goal
from rorg.history.database import reading
from rorg.history.evidence import PROVEN, Evidence
from rorg.host.watch import Watcher
from rorg.model.units import stamp

POLICY = {"robot": {"updates": {"bake": "100ms"}}}


def says(number: int) -> dict:
    """It is proven as soon as it says so."""
    command = ["sh", "-c", f"echo up; while sleep 1000; do echo {number}; done"]
    return {"always_on": True, "ready": {"log": "^up"}, "command": command}


def ends(number: int) -> dict:
    """It fails: each run ends with this exit code."""
    return {"always_on": True, "command": ["sh", "-c", f"exit {number}"]}


def runs_with(marker: Path) -> dict:
    """It runs well while this file exists, and fails without it."""
    return {"always_on": True, "command": ["sh", "-c", f"test -e {marker} || exit 3; exec sleep 1000"]}


def commit(robot, message: str, services: dict) -> str:
    """Manifests that are committed; the commit."""
    write_tree(robot.tree, services, policies=POLICY)
    git(robot, "add", "services", "policies")
    git(robot, "commit", "--quiet", "--message", message)
    return git(robot, "rev-parse", "HEAD")


def made(robot) -> dict[str, str]:
    """Digests of what runs, by service."""
    return {c.service: c.digest for c in robot.containers() if c.state == "running"}


def good(robot, commit: str) -> dict[str, str]:
    """Waits until a commit is on record as good; what runs then."""
    stands(robot, commit, "good")
    return made(robot)


def proven(robot, service: str) -> int:
    """In how many editions a service was proven."""
    with reading(robot.state.journal) as database:
        return sum(v.code == PROVEN for (name, _), v in Evidence(database).all().items() if name == service)


class Robot(RealRobot):
    """Of two commits: arm and base, both of them changed in the second one."""

    def init(self) -> None:
        """Makes a repository without a commit."""
        (self.tree.parent / "manifests").symlink_to(self.tree)
        self.tree.mkdir(exist_ok=True)
        git(self, "init", "--quiet")

    def begin(self) -> None:
        self.init()
        self.first = commit(self, "one", {"arm": says(1), "base": says(1)})
        self.start()
        self.was = good(self, self.first)
        self.second = commit(self, "two", {"arm": says(2), "base": says(2)})
        self.now = good(self, self.second)
        assert self.was.keys() == self.now.keys() == {"arm", "base"}


@pytest.fixture
def fresh(tmp_path):
    """A robot in a repository without a commit."""
    robot = Robot(tmp_path, "process", None, with_server=True)
    robot.init()
    yield robot
    robot.close()


@pytest.fixture
def running(tmp_path):
    robot = Robot(tmp_path, "process", None, with_server=True)
    robot.begin()
    yield robot
    robot.close()


@pytest.fixture(params=["served", "alone"])
def robot(request, running):
    if request.param == "alone":
        running.stop()
    return running


def test_a_commit_that_overtook_the_reading_is_noted_without_another_event(running):
    """The last event of the commit may come before the tree is read."""
    loop, tree = running.loop, running.loop.tree
    next(thread for thread in loop.threads if isinstance(thread, Watcher)).stop()
    write_tree(running.tree, {"arm": says(3), "base": says(2)}, policies=POLICY)
    git(running, "add", "services")
    loop.wakes.files_changed()
    wait_for(lambda: tree.desired.catalog.services["arm"].spec["command"][-1].endswith("3; done"))
    wait_for(lambda: any(r.commit == running.second and r.dirty for r in revisions(running)))
    git(running, "commit", "--quiet", "--message", "three")
    tree._commit = None  # as if git had been asked just now
    loop.wake()
    third = git(running, "rev-parse", "HEAD")
    wait_for(lambda: any(r.commit == third for r in revisions(running)), 20, "the commit to be on record")


def test_back_to_the_last_good_one(robot):
    said = rorg(robot, "rollback", "--yes", "--wait")
    assert "replace arm   command: sh -c" in said
    assert git(robot, "log", "-1", "--format=%an %s") == f"Ann Roll back to 1 ({robot.first[:12]}): one"
    assert git(robot, "rev-parse", "HEAD^") == robot.second
    assert git(robot, "status", "--porcelain") == ""
    assert git(robot, "diff", robot.first) == ""
    assert made(robot) == robot.was


@pytest.mark.slow
def test_a_rollback_waits_until_its_goal_is_proven_again(running):
    """Its bake has just begun when everything is ready."""
    stands(running, commit(running, "three", {"arm": ends(7), "base": says(2)}), "failed")
    for words in (("rollback", "--wait=proven"), ("restore", "--at", "1", "--wait=proven")):
        rorg(running, *words, "--yes")
        newest = revisions(running)[0]
        assert (newest.commit, newest.standing) == (git(running, "rev-parse", "HEAD"), "good")
    assert "'soon' is not one of 'ready', 'proven'" in rorg(running, "rollback", "1", "--wait=soon", code=2)


@pytest.mark.slow
def test_one_service_alone(running):
    robot = running
    said = rorg(robot, "rollback", "HEAD~1", "--service", "arm", "--yes")
    assert f"Roll back arm to HEAD~1 ({robot.first[:12]}): one" in said
    assert git(robot, "diff", "--name-only", robot.second) == "services/arm.yaml"
    assert made(robot) == {"arm": robot.was["arm"], "base": robot.now["base"]}


@pytest.mark.slow
def test_one_service_goes_back_to_its_last_other_state_that_was_proven(running):
    stands(running, commit(running, "three", {"arm": ends(7), "base": says(2)}), "failed")
    third = commit(running, "four", {"arm": says(4), "base": says(4)})
    good(running, third)
    stands(running, commit(running, "five", {"arm": says(4), "base": ends(7)}), "failed")
    said = rorg(running, "rollback", "--service", "arm", "--yes", code=4)
    assert f"Roll back arm to 2 ({running.second[:12]}): two" in said, "in 4 it is the same, in 3 it failed"
    assert "caution" not in said
    assert git(running, "diff", "--name-only", "HEAD^") == "services/arm.yaml"
    running.wait(lambda: made(running)["arm"] == running.now["arm"])
    wait_for(lambda: revisions(running)[0].number == 6)
    rorg(running, "rollback", "--service", "base", "--yes")
    assert git(running, "log", "-1", "--format=%s") == f"Roll back base to 4 ({third[:12]}): four"
    rorg(running, "rollback", "--service", "arm", "--yes")
    assert git(running, "log", "-1", "--format=%s") == f"Roll back arm to 1 ({running.first[:12]}): one", "further back"
    told = rorg(running, "rollback", "--service", "arm", "--yes", code=5)
    assert "cannot roll arm back: nothing earlier differs in arm" in told


def maps(robot, content: str, **more: dict) -> str:
    """A commit in which arm mounts a file with this content; its program ends if that is bad."""
    (robot.tree / "services/conf").mkdir(exist_ok=True)
    place = robot.tree / "services/conf/map"
    place.write_text(content)
    git(robot, "add", ".")
    command = ["sh", "-c", f"grep -q bad {place} && exit 3; echo up; while sleep 1000; do :; done"]
    arm = {**says(3), "mounts": ["./conf:/conf"], "command": command}
    return commit(robot, f"map {content}", {"arm": arm, "base": says(2), **more})


def test_one_service_goes_back_with_the_files_that_it_mounts(running):
    good(running, maps(running, "3"))
    stands(running, maps(running, "bad"), "failed")
    assert back(running, "--service", "arm") == "Roll back arm to 3"
    assert git(running, "diff", "--name-only", "HEAD^") == "services/conf/map"


@pytest.mark.slow
def test_one_service_goes_not_back_with_files_that_another_mounts_too(running):
    other = {"other": {"mounts": ["./conf/map:/map"]}}
    third = maps(running, "3", **other)
    stands(running, third, "untested")
    wait_for(lambda: proven(running, "arm") == 3, what="arm to be proven")
    stands(running, maps(running, "bad", **other), "failed")
    told = rorg(running, "rollback", "--service", "arm", "--yes", code=5)
    why = "cannot roll arm back: other mounts services/conf/map too, which would go back with it"
    assert f"{why}; try `rorg rollback REV` for all services" in told
    assert git(running, "log", "-1", "--format=%s") == "map bad"


@pytest.mark.slow
def test_one_service_of_which_only_other_files_differ_goes_back_with_all(running):
    variables = running.tree / "services/variables"
    for value, standing in (("good", "good"), ("bad", "failed")):
        variables.write_text(f"MAP={value}\n")
        git(running, "add", ".")
        command = ["sh", "-c", 'test "$MAP" = good || exit 3; echo up; while sleep 1000; do :; done']
        arm = {**says(3), "container": {"env_file": ["variables"]}, "command": command}
        stands(running, commit(running, value, {"arm": arm, "base": says(2)}), standing)
    told = rorg(running, "rollback", "--service", "arm", "--yes", code=5)
    why = "only other files than its manifest and mounts differ from 3, where it was proven"
    assert f"cannot roll arm back: {why}; try `rorg rollback 3` for all services" in told


@pytest.mark.slow
def test_the_printed_commands_do_the_same(running):
    robot = running
    lines = rorg(robot, "rollback", robot.first, "--print").splitlines()
    assert git(robot, "rev-parse", "HEAD") == robot.second
    assert all(line.startswith("git ") for line in lines)
    subprocess.run(["sh", "-ec", "\n".join(lines)], env={**os.environ, **ANN}, check=True, capture_output=True)
    assert git(robot, "diff", robot.first) == ""
    assert git(robot, "log", "-1", "--format=%s") == f"Roll back to {robot.first[:12]}: one"


@pytest.mark.slow
def test_commands_that_would_drop_uncommitted_changes_are_not_printed(running):
    (running.tree / "services/arm.yaml").open("a").write("# mine\n")
    told = rorg(running, "rollback", "1", "--print", code=5)
    assert "cannot go back: not committed: services/arm.yaml; try `git -C" in told
    assert rorg(running, "rollback", "1", "--yes", code=5) == told


@pytest.mark.slow
def test_an_uncommitted_change_of_an_image_source_outside_of_the_manifests_counts_too(tmp_path):
    robot = Robot(tmp_path, "process", None)
    robot.tree.mkdir()
    git(robot, "init", "--quiet", "..")
    image = "apiVersion: rorg/v1\nkind: Image\nmetadata: {name: arm}\nspec: {context: ../../arm}\n"
    for path, text in {"images/arm.yaml": image, "../arm/Dockerfile": "FROM scratch\n"}.items():
        (robot.tree / path).parent.mkdir()
        (robot.tree / path).write_text(text)
    git(robot, "add", "../arm", "images")
    commit(robot, "one", {"arm": {"image": "arm"}})
    commit(robot, "two", {"arm": {"image": "arm", "priority": 7}})
    asked = ("rollback", "HEAD~1", "--manifests", str(robot.tree), "--print")
    assert " arm " in rorg(robot, *asked)
    (tmp_path / "arm/Dockerfile").write_text("FROM scratch\n# mine\n")
    assert "cannot go back: not committed: arm/Dockerfile; try" in rorg(robot, *asked, code=5)
    assert "cannot go back: not committed: arm/Dockerfile; try" in rorg(robot, *asked[:-1], "--yes", code=5)
    asked = (*asked, "--service", "arm")
    assert rorg(robot, *asked).splitlines()[0].endswith(f"-- {robot.tree.name}/services/arm.yaml"), "that stays"
    robot.close()


@pytest.mark.slow
def test_twice_goes_further_back(running):
    third = commit(running, "three", {"arm": says(3), "base": says(3)})
    good(running, third)
    rorg(running, "rollback", "--yes")
    good(running, git(running, "rev-parse", "HEAD"))
    assert made(running) == running.now
    rorg(running, "rollback", "--yes")
    assert made(running) == running.was
    good(running, git(running, "rev-parse", "HEAD"))
    assert "cannot roll back: no earlier revision is on record; try" in rorg(running, "rollback", "--yes", code=5)


def back(robot, *words: str) -> str:
    """Rolls back, and waits until that is good; the subject of the commit."""
    rorg(robot, "rollback", *words, "--yes")
    good(robot, git(robot, "rev-parse", "HEAD"))
    return git(robot, "log", "-1", "--format=%s").split(":")[0].split(" (")[0]


@pytest.mark.parametrize("words", [(), ("--service", "arm")])
def test_a_rollback_leads_to_the_last_other_contents_also_after_a_revert_to_the_first_ones(running, words):
    git(running, "revert", "--no-edit", "HEAD")
    good(running, git(running, "rev-parse", "HEAD"))
    what = "Roll back arm" if words else "Roll back"
    assert back(running, *words) == f"{what} to 2", "a revert is a change like others"
    (running.tree / "readme.md").write_text("more")
    git(running, "add", ".")
    good(running, commit(running, "docs", {"arm": says(2), "base": says(1 if words else 2)}))
    assert back(running, *words) == f"{what} to 1", "the second goes further back"
    assert git(running, "diff", running.first, "--", "services/arm.yaml") == ""
    assert "cannot roll" in rorg(running, "rollback", *words, "--yes", code=5), "there is nothing further back"


@pytest.mark.slow
def test_what_fails_goes_back_although_a_good_change_of_another_service_came_later(running):
    stands(running, commit(running, "three", {"arm": ends(7), "base": says(2)}), "failed")
    stands(running, commit(running, "four", {"arm": ends(7), "base": says(4)}), "failed")
    rorg(running, "rollback", "--yes", "--wait")
    assert git(running, "log", "-1", "--format=%s") == f"Roll back to 2 ({running.second[:12]}): two"
    assert made(running) == running.now


def probed(seconds: int) -> dict:
    """As before, with a probe that never succeeds; it fails after so many seconds."""
    return {**says(2), "ready": {"log": "^never", "timeout": f"{seconds}s"}}


@pytest.mark.slow
def test_a_probe_that_fails_goes_back_although_a_good_change_of_another_service_came_later(running):
    stands(running, commit(running, "three", {"arm": probed(1), "base": says(2)}), "failed")
    stands(running, commit(running, "four", {"arm": probed(1), "base": says(4)}), "failed")
    assert back(running) == "Roll back to 2"


@pytest.mark.slow
def test_what_was_superseded_while_a_change_was_not_proven_is_no_goal_as_long_as_it_is_not(running):
    third = commit(running, "three", {"arm": probed(60), "base": says(2)})
    wait_for(lambda: revisions(running)[0].commit == third)
    stands(running, commit(running, "four", {"arm": probed(60), "base": says(4)}), "baking")
    wait_for(lambda: proven(running, "base") == 3, what="base to be proven")
    assert revisions(running)[1].standing == "superseded"
    assert back(running) == "Roll back to 2"


@pytest.mark.slow
def test_a_revision_that_failed_for_an_earlier_change_names_that_change(running):
    stands(running, commit(running, "three", {"arm": ends(7), "base": says(2)}), "failed")
    stands(running, commit(running, "four", {"arm": ends(7), "base": says(4)}), "failed")
    stands(running, commit(running, "five", {"arm": ends(7), "base": ends(8)}), "failed")
    wait_for(lambda: "base" in revisions(running)[0].reason, what="the failure of base to be on record")
    reasons = {r.number: r.reason for r in revisions(running) if r.standing == "failed"}
    own = "arm: ended with exit code 7"
    assert reasons[3] == own
    assert reasons[4] == f"{own} (arm last changed in revision 3)"
    assert reasons[5] == f"{own}; base: ended with exit code 8 (arm last changed in revision 3)"
    assert f"reason   {reasons[4]}" in rorg(running, "history", "show", "4")
    assert reasons[4] in rorg(running, "history", "-o", "wide")
    assert f"revision 4 of the manifests failed: {reasons[4]}" in rorg(running, "events", "--tail", "100")


@pytest.mark.slow
def test_a_goal_changes_all_that_fails(running):
    third = commit(running, "three", {"arm": ends(7), "base": says(3)})
    stands(running, third, "failed")
    stands(running, commit(running, "four", {"arm": says(4), "base": ends(7)}), "failed")
    stands(running, commit(running, "five", {"arm": ends(8), "base": ends(7)}), "failed")
    rorg(running, "rollback", "--yes", "--wait")
    assert git(running, "diff", running.second) == ""


@pytest.mark.slow
def test_what_never_was_well_holds_no_rollback_back(running):
    new = {"always_on": True, "needs": ["base"], "command": ["sh", "-c", "exit 9"]}
    third = commit(running, "three", {"arm": says(3), "base": says(2), "new": new})
    stands(running, third, "failed")
    wait_for(lambda: proven(running, "arm") == 3, what="arm to be proven")
    before = made(running)["arm"]
    stands(running, commit(running, "four", {"arm": ends(7), "base": says(4), "new": new}), "failed")
    assert "new: ended with exit code 9" in rorg(running, "rollback", "--yes", code=4)
    assert git(running, "diff", third) == ""
    running.wait(lambda: made(running)["arm"] == before)


@pytest.mark.slow
def test_what_was_well_and_fails_as_it_always_was_holds_a_rollback_back(running):
    """To undo the change of another service does not help."""
    marker = running.tree.parent / "marker"
    marker.write_text("")
    arm = runs_with(marker)
    good(running, commit(running, "three", {"arm": arm, "base": says(2)}))
    fourth = commit(running, "four", {"arm": arm, "base": says(4)})
    good(running, fourth)
    marker.unlink()
    running.kill("arm")
    stands(running, fourth, "failed")
    rorg(running, "rollback", "--yes")
    assert git(running, "diff", running.second) == ""


@pytest.mark.slow
def test_without_a_goal_five_revisions_are_named_with_why_each_was_not_taken(fresh):
    write_tree(fresh.tree, {"arm": says(1), "base": says(1)}, policies=POLICY)
    fresh.start()
    wait_for(lambda: [r.standing for r in revisions(fresh)] == ["good"])
    for number in range(2, 9):
        stands(fresh, commit(fresh, str(number), {"arm": ends(number), "base": says(1)}), "failed")
    stands(fresh, commit(fresh, "idle", {"arm": {}, "base": says(1)}), "untested")
    stands(fresh, commit(fresh, "last", {"arm": ends(9), "base": says(1)}), "failed")
    assert rorg(fresh, "rollback", "--yes", code=5).splitlines() == [
        "rorg: cannot roll back: no earlier revision is proven",
        "  9: arm never ran as declared then",
        *(f"  {number}: arm failed in it (ended with exit code {number})" for number in (8, 7, 6, 5)),
        "  and 4 earlier",
        f"try `rorg rollback REV`, with a REV of `rorg history` or `git -C {fresh.tree} log`",
    ]


@pytest.mark.slow
def test_nothing_earlier_differs_in_what_fails(fresh):
    marker = fresh.tree.parent / "marker"
    marker.write_text("")
    arm = runs_with(marker)
    first = commit(fresh, "one", {"arm": arm, "base": says(1)})
    fresh.start()
    good(fresh, first)
    second = commit(fresh, "two", {"arm": arm, "base": says(2)})
    good(fresh, second)
    marker.unlink()
    fresh.kill("arm")
    stands(fresh, second, "failed")
    why, remedy = "nothing earlier differs in arm", f"with a REV of `rorg history` or `git -C {fresh.tree} log`"
    told = f"rorg: cannot roll back: {why}; fix arm, or try `rorg rollback REV`, {remedy}\n"
    assert rorg(fresh, "rollback", "--yes", code=5) == told


@pytest.mark.slow
def test_what_git_has_not_is_passed_over(running):
    """A file that does not count is no reason, though the state was not clean with it."""
    (running.tree / "notes.txt").write_text("mine")
    third = commit(running, "three", {"arm": says(3), "base": says(2)})
    before = good(running, third)
    known = revisions(running)[0]
    assert known.dirty
    write_tree(running.tree, {"arm": says(4), "base": says(2)})
    wait_for(lambda: revisions(running)[0].number > known.number and revisions(running)[0].standing == "good")
    lost = revisions(running)[0].number
    fifth = commit(running, "five", {"arm": says(5), "base": says(2)})
    good(running, fifth)
    assert "with uncommitted changes" in rorg(running, "rollback", str(lost), "--yes", code=5)
    rorg(running, "rollback", "--yes")
    assert git(running, "log", "-1", "--format=%s") == f"Roll back to {known.number} ({third[:12]}): three"
    assert made(running) == before


def test_from_manifests_that_are_refused(running):
    commit(running, "broken", {"arm": {"nonsense": 1}, "base": says(2)})
    wait_for(lambda: revisions(running)[0].standing == "refused")
    rorg(running, "rollback", "--yes", "--wait")
    assert git(running, "diff", running.second) == ""
    assert made(running) == running.now


def test_a_service_that_is_requested_goes_with_the_same_yes(running):
    third = commit(running, "three", {"arm": says(2), "base": says(2), "extra": {}})
    stands(running, third, "untested")
    running.request("extra")
    running.wait(lambda: "extra" in running.active())
    good(running, third)
    said = rorg(running, "rollback", running.second, "--yes")
    assert "To remove after you confirm, although still named: extra" in said
    assert made(running) == running.now


def test_a_comparison_of_revisions_leads_to_the_manifests_if_no_container_differs(running):
    third = commit(running, "three", {"arm": {**says(2), "conflicts": ["base"], "always_on": False}, "base": says(2)})
    stands(running, third, "good")
    with_headers = rorg(running, "history").splitlines()
    assert rorg(running, "history", "--no-headers").splitlines() == with_headers[1:]
    same = "no container differs between revisions 2 and 3; `rorg diff 2..3` compares the manifests\n"
    assert rorg(running, "history", "diff", "2", "3") == same
    assert "conflicts: + base" in rorg(running, "diff", "2..3", code=1)
    assert rorg(running, "history", "diff", "3", "3") == "the manifests of revisions 3 and 3 are the same\n"


@pytest.mark.slow
def test_what_cannot_be_done_changes_nothing(running):
    assert "find the revision 'nonsense'" in rorg(running, "rollback", "nonsense", code=2)
    assert "find the revision '99'" in rorg(running, "rollback", "99", code=2)
    assert "no such service; try 'arm'" in rorg(running, "rollback", "--service", "amr", code=2)
    told = rorg(running, "rollback", "1", "--service", "amr", code=5)
    assert f"cannot roll amr back: it was not declared in 1 ({running.first[:12]}): one" in told
    assert "there is no terminal; try --yes" in rorg(running, "rollback", code=5)
    assert "the same already" in rorg(running, "rollback", running.second, "--yes")
    assert made(running) == running.now
    (running.tree / "services/arm.yaml").open("a").write("# mine\n")
    (running.tree / "services/new.yaml").write_text("apiVersion: rorg/v1\nkind: Service\n")
    told = rorg(running, "rollback", "1", "--yes", code=5)
    assert "cannot go back: not committed: services/arm.yaml, services/new.yaml; try `git -C" in told
    assert git(running, "rev-parse", "HEAD") == running.second
    (running.tree / ".git").rename(running.tree / "git")
    assert "in no git repository that this user may read; try" in rorg(running, "rollback", "1", "--yes", code=5)


def test_a_commit_that_changes_nothing_that_runs_is_not_made_without_a_yes(fresh):
    first = commit(fresh, "one", {"arm": {}})
    fresh.start()
    stands(fresh, first, "untested")
    second = commit(fresh, "two", {"arm": {"priority": 7}})
    wait_for(lambda: revisions(fresh)[0].commit == second)
    for words in (("rollback", "1"), ("rollback", "1", "--service", "arm"), ("restore", "--at", "1")):
        assert "it needs confirmation, and there is no terminal; try --yes" in rorg(fresh, *words, code=5)
        assert git(fresh, "rev-parse", "HEAD") == second
    assert "the same already" in rorg(fresh, "rollback", "2"), "there is nothing to confirm"
    rorg(fresh, "rollback", "1", "--yes")
    assert git(fresh, "diff", first) == ""


def test_a_robot_without_a_history_goes_by_git(tmp_path):
    robot = Robot(tmp_path, "process", None)
    robot.init()
    first = commit(robot, "one", {"arm": says(1)})
    commit(robot, "two", {"arm": says(2)})
    assert "no earlier revision is on record" in rorg(robot, "rollback", "--yes", code=5)
    rorg(robot, "rollback", "HEAD~1", "--yes")
    assert git(robot, "diff", first) == ""
    robot.close()


def test_one_service_of_a_fleet_with_its_overlay(tmp_path):
    robot = Robot(tmp_path, "process", None)
    robot.tree.mkdir()
    git(robot, "init", "--quiet")
    write_tree(robot.tree / "robots/fetch", {"arm": {"priority": 7}})
    write_tree(robot.tree / "robots/other", {"arm": {"priority": 8}})
    commit(robot, "one", {"arm": says(1)})
    git(robot, "add", "robots")
    git(robot, "commit", "--quiet", "--message", "two")
    asked = ("rollback", "HEAD~1", "--service", "arm", "--print", "--manifests", str(robot.tree), "--robot", "fetch")
    assert all(
        line.endswith("-- robots/fetch/services/arm.yaml services/arm.yaml")
        for line in rorg(robot, *asked).split("\n")[:2]
    )
    robot.close()


@pytest.mark.slow
def test_restore_brings_requests_back_too(robot):
    """Of people; what has a lease is left alone."""
    served = robot.loop is not None
    if not served:
        robot.start()
    robot.request("arm", id="tour", reason="a tour")
    third = commit(robot, "three", {"arm": says(3), "base": says(1)})
    before = good(robot, third)
    then = revisions(robot)[0]
    robot.release("tour")
    robot.request("base", id="other")
    robot.request("base", id="leased", ttl=1000.0)
    fourth = commit(robot, "four", {"arm": says(4), "base": says(1)})
    good(robot, fourth)
    if not served:
        robot.stop()
    said = rorg(robot, "restore", "--at", then.settled_at, "--yes", "--wait")
    assert "- request 'other' of developer: base" in said
    assert "+ request 'tour' of developer: arm" in said
    assert git(robot, "diff", third) == ""
    assert made(robot) == before
    assert sorted(r.id for r in robot.requests()) == ["leased", "tour"]
    assert "revision 1" in rorg(robot, "restore", "--at", "1", code=5)


@pytest.mark.parametrize("served", [True, False])
def test_restore_shows_what_the_requests_start_before_it_asks(fresh, served):
    runs = {"command": says(1)["command"]}
    services = {"arm": {**runs, "driver": True}, "nav": {**runs, "needs": ["arm"]}, "map": runs}
    first = commit(fresh, "one", services)
    fresh.start()
    stands(fresh, first, "untested")
    fresh.request("nav", id="tour")
    good(fresh, first)
    then = stamp(time.time())
    fresh.release("tour")
    fresh.request("map", id="other")
    fresh.wait(lambda: fresh.active() == {"map"})
    if not served:
        fresh.stop()
    told = rorg(fresh, "restore", "--at", then, code=5)
    assert "+ request 'tour' of developer: nav\n" in told
    assert "to start because of these requests: arm (moves hardware), nav\n" in told
    assert "to end because of these requests: map\n" in told
    assert "No differences of the manifests.\n" in told
    assert "there is no terminal; try --yes" in told


def test_restore_needs_a_time_that_is_on_record(running):
    assert "no time is named" in rorg(running, "restore", code=2)
    assert "nothing is on record of 20" in rorg(running, "restore", "--at", "10h", code=5)
    told = rorg(running, "restore", "--at", "2999-01-01T00:00:00Z", "--yes", code=5)
    assert "2999-01-01T00:00:00.000000Z is in the future; try a time such as 10m (ago)" in told
    assert "find the revision 'yesterday'" in rorg(running, "restore", "--at", "yesterday", code=2)
    assert git(running, "rev-parse", "HEAD") == running.second


def test_the_tree_is_that_of_the_running_rorg_also_if_a_loss_of_power_took_what_it_published(running):
    running.state.status.unlink()
    running.state.status.mkdir()  # so that it is not published again
    elsewhere = running.tree.parent / "elsewhere"
    elsewhere.mkdir()
    commands.rorg("rollback", "1", "--yes", cwd=elsewhere, RORG_STATE_DIR=str(running.state.path), **ANN)
    assert git(running, "log", "-1", "--format=%s").startswith("Roll back to 1")


@pytest.mark.parametrize("before", ["Roll back to 5 (edef05a2b956): ", "Roll back arm to HEAD~1 (0123456789ab): " * 2])
def test_a_return_to_a_rollback_names_the_commit_that_it_led_to(before):
    goal = Goal("a" * 40, "7", f"{before}Mount the script")
    assert goal.title == "7 (aaaaaaaaaaaa): Mount the script"
