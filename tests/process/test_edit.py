"""`rorg edit`: an editor on a manifest, beside a running rorg and without one."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import commands
import pytest
from editors import EDITOR
from robots import RealRobot

SERVICES = {"arm": {}, "base": {"always_on": True}}


@pytest.fixture(params=["served", "alone"])
def robot(request, tmp_path):
    """Its tree is in git."""
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(SERVICES, groups={"both": {"services": ["arm", "base"]}})
    git(found, "init", "--quiet")
    git(found, "add", ".")
    git(found, "-c", "user.name=x", "-c", "user.email=x@localhost", "commit", "--quiet", "--message", "all")
    found.wait(lambda: "base" in found.active())
    if request.param == "alone":
        found.stop()
    yield found
    found.close()


def git(robot, *words: str) -> str:
    return subprocess.check_output(["git", "-C", robot.tree, *words], text=True).strip()


def edit(robot, name: str, change: str = "pass", code: int = 0, **environment: str) -> str:
    """What was said. `change` is a statement about the `text` in the editor, and about its `path`."""
    script = robot.state.path.parent / "editor.py"
    script.write_text(f"{EDITOR}\n{change}\npath.write_text(text)")
    environment = {
        "RORG_STATE_DIR": str(robot.state.path),
        "RORG_ENGINE": "process",
        "VISUAL": "",
        "EDITOR": f"'{sys.executable}' '{script}'",
        "TMPDIR": str(robot.state.path.parent),
        **environment,
    }
    done = commands.rorg("edit", name, code=code, cwd=robot.tree.parent, **environment)
    return done.stdout + done.stderr


def manifest(robot, name: str) -> Path:
    return robot.tree / f"services/{name}.yaml"


@pytest.fixture(autouse=True)
def _manifests_lie_beside(robot):
    """Where no rorg runs, commands look at ./manifests."""
    (robot.tree.parent / "manifests").symlink_to(robot.tree)


def leftovers(robot) -> list[Path]:
    return list(robot.tree.parent.glob("rorg-edit-*"))


def test_a_change_is_written_and_committed_by_the_person(robot, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    manifest(robot, "arm").chmod(0o640)
    said = edit(robot, "arm", "text += '  priority: 7\\n'")
    assert said == "service arm edited\n"
    assert "priority: 7" in manifest(robot, "arm").read_text()
    assert manifest(robot, "arm").stat().st_mode & 0o777 == 0o640
    assert git(robot, "status", "--porcelain") == ""
    assert git(robot, "log", "-1", "--format=%s") == "edit service arm"
    login = subprocess.check_output(["id", "-un"], text=True).strip()
    assert git(robot, "log", "-1", "--format=%an <%ae>") == f"{login} <{login}@{socket.gethostname()}>"
    assert not leftovers(robot)


def test_the_author_is_the_one_that_git_knows(robot, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".gitconfig").write_text("[user]\nname = Cleo\nemail = cleo@lab\n")
    edit(robot, "arm", "text += '  priority: 7\\n'")
    assert git(robot, "log", "-1", "--format=%an <%ae>, %cn <%ce>") == "Cleo <cleo@lab>, Cleo <cleo@lab>"


@pytest.mark.slow
def test_other_kinds_have_their_kind_in_front(robot):
    assert edit(robot, "group/both", "text = text.replace('- base\\n', '')") == "group both edited\n"
    assert "base" not in (robot.tree / "groups/both.yaml").read_text()


@pytest.mark.slow
def test_what_is_left_as_it_is_changes_nothing(robot):
    for change in ("pass", "text = ''", "text = '# rorg: hello\\n' + text"):
        assert edit(robot, "service/arm", change) == "nothing changed\n"
    assert git(robot, "log", "--format=%s") == "all"
    assert not leftovers(robot)


@pytest.mark.slow
def test_a_mistake_is_shown_on_top_and_the_editor_opens_again(robot, tmp_path):
    seen = tmp_path / "seen"
    change = (
        f"open({str(seen)!r}, 'a').write(text + '=====')\n"
        "text = text.replace('prority', 'priority') if 'prority' in text else text + '  prority: 7\\n'"
    )
    assert edit(robot, "arm", change) == "service arm edited\n"
    first, second, _ = seen.read_text().split("=====")
    assert not first.startswith("#")
    assert second.startswith("# rorg: cannot change the Service 'arm'")
    assert "priority" in second.partition("prority: 7")[0], "it says what is meant"
    assert "# rorg" not in manifest(robot, "arm").read_text()
    assert "  priority: 7" in manifest(robot, "arm").read_text()


@pytest.mark.slow
def test_a_mistake_that_stays_is_refused_and_the_text_kept(robot):
    before = manifest(robot, "arm").read_text()
    said = edit(robot, "arm", "text += '' if 'nonsense' in text else '  nonsense: 7\\n'", code=2)
    assert "nonsense" in said
    kept = leftovers(robot)[0] / "arm.yaml"
    assert str(kept) in said
    assert "nonsense: 7" in kept.read_text()
    assert manifest(robot, "arm").read_text() == before


@pytest.mark.slow
def test_what_somebody_else_has_changed_meanwhile_stays(robot):
    change = f"open({str(manifest(robot, 'arm'))!r}, 'a').write('  priority: 3\\n'); text += '  priority: 7\\n'"
    assert "it was changed meanwhile" in edit(robot, "arm", change, code=5)
    assert "priority: 3" in manifest(robot, "arm").read_text()
    assert "priority: 7" in (leftovers(robot)[0] / "arm.yaml").read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "code", "told", "environment"),
    [
        ("amr", 2, "find the service 'amr': no such service; try 'arm'", {}),
        ("gruop/both", 2, "find the kind 'gruop': no such kind; try 'group'", {}),
        ("arm", 2, "another EDITOR", {"EDITOR": "false"}),
        ("arm", 2, "try EDITOR=nano", {"EDITOR": "/nosuch/editor"}),
        ("arm", 2, "there is no terminal; try", {"EDITOR": ""}),
        ("arm", 2, "try EDITOR=nano", {"EDITOR": "'vi"}),
    ],
)
def test_what_cannot_be_edited_is_told(robot, name, code, told, environment):
    assert told in edit(robot, name, code=code, **environment)


@pytest.mark.slow
def test_the_other_documents_of_a_file_stay(robot):
    path, second = manifest(robot, "arm"), manifest(robot, "base")
    text = f"{path.read_text()}---\n# the second\n{second.read_text()}"
    path.write_text(text)
    second.unlink()
    assert edit(robot, "base", "text += '  priority: 7\\n'") == "service base edited\n"
    assert path.read_text() == f"{text}  priority: 7\n"
    assert edit(robot, "arm", "text += '  priority: 8\\n'") == "service arm edited\n"
    assert path.read_text() == f"{text}  priority: 7\n".replace("---", "  priority: 8\n---", 1)
