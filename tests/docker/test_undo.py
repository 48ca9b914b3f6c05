"""Undo can be trusted: what history says of a revision is so, and `rorg rollback` leads to what was proven."""

from __future__ import annotations

import shlex

import pytest
import yaml
from robots import WORK, RealRobot, write_tree
from rolled_back import git, revisions, rorg, stands

WELL = f"exec {shlex.join(WORK)}"
ENDS = "exit 7"
AT = "2026-01-01T00:00:05Z"
POLICY = {"robot": {"updates": {"bake": "100ms"}}}


class Mounted(RealRobot):
    """A robot in git whose `nav` runs a script that it mounts; nothing is always on."""

    def begin(self) -> None:
        (self.tree.parent / "manifests").symlink_to(self.tree)
        self.tree.mkdir(exist_ok=True)
        git(self, "init", "--quiet")
        script = "/conf/start.sh" if self.kind == "docker" else self.tree / "services/nav/start.sh"
        nav = {"command": ["sh", str(script)], "mounts": ["./nav:/conf"]}
        (self.tree / "services/nav").mkdir(parents=True)
        write_tree(self.tree, {"nav": nav, "other": {}}, policies=POLICY)
        self.first = self.save(WELL)
        self.start()
        self.request("nav")
        stands(self, self.first, "good")

    def save(self, script: str) -> str:
        """Commits the mounted script; the commit."""
        (self.tree / "services/nav/start.sh").write_text(script)
        git(self, "add", ".")
        git(self, "commit", "--quiet", "--message", "bad" if script.endswith(ENDS) else "well")
        return git(self, "rev-parse", "HEAD")

    def rollback(self, *words: str, code: int = 0) -> str:
        return rorg(self, "rollback", *words, code=code, RORG_ENGINE=self.kind)

    def history(self) -> dict[int, str]:
        return {r.number: r.standing for r in revisions(self)}


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.docker)])
def mounted(request, tmp_path):
    host = request.getfixturevalue("dockerd").host if request.param == "docker" else None
    robot = Mounted(tmp_path, request.param, host, with_server=True)
    robot.begin()
    yield robot
    robot.close()


@pytest.mark.slow
@pytest.mark.smoke
def test_a_bad_mounted_file_is_rolled_back(mounted):
    bad = mounted.save(ENDS)
    stands(mounted, bad, "failed")
    assert "git -C" in mounted.rollback("--print")
    said = mounted.rollback("--yes", "--wait")
    assert "files that change: services/nav/start.sh" in said
    assert git(mounted, "log", "-1", "--format=%s") == f"Roll back to 1 ({mounted.first[:12]}): well"
    stands(mounted, git(mounted, "rev-parse", "HEAD"), "good")
    assert (mounted.tree / "services/nav/start.sh").read_text() == WELL


WAS_WELL = "caution: it was well before its last change"


@pytest.mark.slow
def test_why_names_the_rollback_of_a_bad_mounted_file(mounted):
    def why() -> str:
        return rorg(mounted, "why", "nav", RORG_ENGINE=mounted.kind)

    assert "caution" not in why()
    bad = mounted.save(ENDS)
    stands(mounted, bad, "failed")
    assert f"  {WAS_WELL}, which `rorg rollback` undoes\n" in why()
    assert mounted.client().why("nav")[0]["cautions"] == [WAS_WELL[9:] + ", which `rorg rollback` undoes"], "the page's"
    assert "caution" not in rorg(mounted, "why", "other", RORG_ENGINE=mounted.kind)
    mounted.stop()
    assert WAS_WELL in why(), "also where no rorg runs"
    mounted.start()
    mounted.rollback("--yes", "--wait")
    assert "caution" not in why()


def test_why_names_the_rollback_of_a_change_that_was_undone(mounted):
    write_tree(mounted.tree, {"nav": {"command": ["sh", "-c", ENDS]}, "other": {}}, policies=POLICY)
    git(mounted, "add", ".")
    git(mounted, "commit", "--quiet", "--message", "two")
    stands(mounted, git(mounted, "rev-parse", "HEAD"), "failed")
    mounted.wait(lambda: mounted.active() == {"nav"})
    assert f"{WAS_WELL}, which `rorg rollback` undoes" in rorg(mounted, "why", "nav", RORG_ENGINE=mounted.kind)


def test_why_names_no_rollback_outside_of_git(tmp_path):
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    try:
        robot.declare({"nav": {"always_on": True, "command": ["sh", "-c", WELL]}}, policies=POLICY)
        robot.wait(lambda: robot.loop.decision and robot.loop.decision.memory.of("nav").update.baked)
        robot.declare({"nav": {"always_on": True, "command": ["sh", "-c", ENDS]}}, policies=POLICY)
        robot.wait(lambda: robot.loop.decision.memory.of("nav").update.quarantined)
        assert rorg(robot, "why", "nav").endswith(f"{WAS_WELL}\n")
    finally:
        robot.close()


@pytest.mark.slow
def test_the_plan_of_a_rollback_shows_changed_files_of_what_runs(mounted):
    second = mounted.save(f"# slower\n{WELL}")
    stands(mounted, second, "good")
    said = mounted.rollback("1", "--yes")
    assert "nav" in said
    assert "changed: services/nav" in said
    assert "No differences" not in said


@pytest.mark.slow
def test_of_many_revisions_that_differ_in_a_file_the_last_proven_one_comes_back(mounted):
    """Once it went back past all of them, to a known crash loop."""
    for number in (2, 3, 4):
        stands(mounted, mounted.save(f"# {number}\n{WELL}"), "good")
    stands(mounted, mounted.save(ENDS), "failed")
    mended = mounted.save(f"# 6\n{WELL}")
    stands(mounted, mended, "good")
    stands(mounted, mounted.save(f"# 7\n{ENDS}"), "failed")
    mounted.rollback("--yes")
    assert git(mounted, "log", "-1", "--format=%s").startswith(f"Roll back to 6 ({mended[:12]})")


@pytest.mark.slow
def test_a_release_repairs_nothing(mounted):
    bad = mounted.save(ENDS)
    stands(mounted, bad, "failed")
    number = revisions(mounted)[0].number
    mounted.release()
    mounted.wait(lambda: mounted.quiet() and not mounted.requests())
    passes = mounted.loop.passes
    mounted.loop.wake()
    mounted.wait(lambda: mounted.loop.passes > passes + 1 or not mounted.loop.wake())
    mounted.stop()
    mounted.start()
    mounted.wait(lambda: mounted.loop.decision is not None and mounted.loop.tree.standing is not None)
    assert mounted.loop.tree.standing.code == "failed"
    assert mounted.history()[number] == "failed"


@pytest.mark.slow
def test_what_was_good_and_then_fails_says_so(mounted):
    """Its program needs a file that somebody takes away."""
    marker = mounted.tree.parent / "marker"
    marker.write_text("")
    place = "/marker/marker" if mounted.kind == "docker" else marker
    spec = {
        "always_on": True,
        "command": ["sh", "-c", f"test -e {place} || exit 3; {WELL}"],
        "container": {"volumes": [f"{marker.parent}:/marker"]},
    }
    write_tree(mounted.tree, {"nav": {}, "other": spec}, policies=POLICY)
    git(mounted, "add", ".")
    git(mounted, "commit", "--quiet", "--message", "two")
    second = git(mounted, "rev-parse", "HEAD")
    stands(mounted, second, "good")
    marker.unlink()
    mounted.kill("other")
    stands(mounted, second, "failed")
    said = rorg(mounted, "history", RORG_ENGINE=mounted.kind)
    assert "good, then failed at " in said
    assert "not known to work" not in said
    write_tree(mounted.tree, {"nav": {}, "other": {**spec, "priority": 7}}, policies=POLICY)
    git(mounted, "add", ".")
    git(mounted, "commit", "--quiet", "--message", "three")
    stands(mounted, git(mounted, "rev-parse", "HEAD"), "failed")
    said = mounted.rollback("--yes", code=5)
    assert "\n  2: it does not change what fails now: other" in said, "whatever was read before it was committed"
    assert "\n  1: other never ran as declared then\n" in said
    log = f"git -C {mounted.tree} log"
    assert said.endswith(f"\ntry `rorg rollback REV`, with a REV of `rorg history` or `{log}`\n")


@pytest.mark.slow
def test_what_was_never_tried_is_untested_and_no_goal_of_a_rollback(mounted):
    changed = {"container": {"environment": {"N": "1"}}}
    nav = {"command": ["sh", "-c", WELL]}
    write_tree(mounted.tree, {"nav": nav, "other": changed}, policies=POLICY)
    git(mounted, "add", ".")
    git(mounted, "commit", "--quiet", "--message", "two")
    second = git(mounted, "rev-parse", "HEAD")
    stands(mounted, second, "untested")
    write_tree(mounted.tree, {"nav": nav, "other": {"command": ["sh", "-c", ENDS]}}, policies=POLICY)
    git(mounted, "add", ".")
    git(mounted, "commit", "--quiet", "--message", "three")
    third = git(mounted, "rev-parse", "HEAD")
    stands(mounted, third, "untested")
    mounted.request("other", id="more")
    stands(mounted, third, "failed")
    said = mounted.rollback(code=5)
    assert "\n  2: other never ran as declared then\n  1: other never ran as declared then\n" in said
    said = mounted.rollback("2", "--yes")
    assert "caution: revision 2 is not known to work: other never ran as declared then" in said


@pytest.mark.slow
@pytest.mark.parametrize("mounted", [pytest.param("docker", marks=pytest.mark.docker)], indirect=True)
def test_an_image_that_cannot_be_obtained_fails_too(mounted):
    """Nothing of its edition ever runs, so no run can show it."""
    nav = yaml.safe_load((mounted.tree / "services/nav.yaml").read_text())["spec"]
    mounted.request("other", id="more")
    for other in {}, {"container": {"environment": {"N": "1"}}}:
        mounted.wait(lambda: (update := mounted.loop.decision.memory.of("other").update).baked == update.edition)
        write_tree(mounted.tree, {"nav": {**nav, "image": "registry.invalid/nav:2"}, "other": other}, policies=POLICY)
        stands(mounted, mounted.save(WELL), "failed")
    mounted.rollback("--yes")
    assert git(mounted, "diff", mounted.first) == ""


@pytest.mark.slow
def test_a_return_to_a_failed_revision_is_not_made_without_a_word(mounted):
    bad = mounted.save(ENDS)
    stands(mounted, bad, "failed")
    mended = mounted.save(f"# mended\n{WELL}")
    stands(mounted, mended, "good")
    then = next(r for r in revisions(mounted) if r.commit == bad)
    said = rorg(mounted, "restore", "--at", then.settled_at, code=5, RORG_ENGINE=mounted.kind)
    assert f"caution: revision {then.number} failed: nav: " in said


def test_history_of_an_older_rorg_is_read_and_trusted(tmp_path):
    """Its file has neither verdicts nor when a revision was proven."""
    import sqlite3

    from rorg.history.database import reading
    from rorg.history.evidence import earlier_revisions
    from rorg.history.revisions import Revisions
    from rorg.history.schema import STEPS

    path = tmp_path / "journal.db"
    file = sqlite3.connect(path)
    for step in STEPS[:2]:
        file.executescript(step)
    file.executescript("PRAGMA user_version = 2;")
    row = f"INSERT INTO revision VALUES (?, '{AT}', ?, '', '', '', 0, '', ?, '', '{AT}', '', '[]')"
    file.executemany(row, [(1, "a", "good"), (2, "b", "failed"), (3, "c", "failed")])
    made = "INSERT INTO made VALUES ('arm', ?, ?, ?, '', '', ?)"
    file.executemany(made, [(1, 1, "v1:1", "e1"), (2, 2, "v1:2", "e2"), (3, None, "v1:3", "e3")])
    file.commit()
    file.close()
    with reading(path) as database:
        assert Revisions(database).get(1).proven_at == AT
        found = {e.number: e.doubt for e in earlier_revisions(database)}
    assert found == {2: "arm never ran as declared then", 1: ""}
    assert sqlite3.connect(path).execute("PRAGMA user_version").fetchone() == (2,), "only its owner upgrades it"
