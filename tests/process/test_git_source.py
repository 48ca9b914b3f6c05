"""Manifests in git: whose repository it is, and a repository that rorg follows."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import threading
from dataclasses import replace
from pathlib import Path

import other_users as others
import pytest
from common import free_port, wait_for
from git_origin import Origin, git
from robots import write_tree
from tools import tool

from rorg.api.manifest_change import ManifestChange
from rorg.host.git import Commit, commit, head, revision
from rorg.host.git_cache import Followed, GitCache, Unacceptable, Unreachable
from rorg.host.git_remote import Remote, remote, without_user

OTHER = 47_003
"""The number of a user that the machine does not know."""
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root acts for others")


def committed(folder: Path, message: str = "Begin", **more) -> str:
    """The hash of a commit of all that is there."""
    git(folder, "add", "--all", **more)
    git(folder, "commit", "--quiet", "--allow-empty", "--message", message, **more)
    return git(folder, "rev-parse", "HEAD", **more)


@pytest.fixture
def tree(tmp_path):
    found = write_tree(tmp_path / "robot", {"camera": {}})
    git(found, "init", "--quiet")
    return found


# -- what git says of a tree -----------------------------------------------------------------------------------


def test_the_head_of_a_tree(tree):
    assert head(tree) is None, "before the first commit"
    made = committed(tree, "A camera\n\nfor the arm")
    found = head(tree / "services")
    assert found == Commit(made, "Anna", "A camera", found.at, False)
    assert found.at.startswith("20")
    assert found.at.endswith("Z")
    (tree / "services/camera.yaml").write_text("x")
    assert head(tree).dirty
    assert head(tree.parent) is None


def test_rorg_commits_where_a_person_signs(tree, tmp_path, monkeypatch):
    """Nobody is there who could be asked for a passphrase."""
    (tmp_path / ".gitconfig").write_text("[commit]\n\tgpgSign = true\n[gpg]\n\tprogram = false\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    committed(tree)
    (tree / "services/camera.yaml").write_text("x")
    assert commit(tree, tree / "services/camera.yaml", "Anna", "Change")


# -- another user's repository ---------------------------------------------------------------------------------


@pytest.fixture
def theirs():
    """The clone of another user, whose hooks and filters tell who runs them."""
    folder = Path(tempfile.mkdtemp(prefix="rorg-theirs-"))
    folder.chmod(0o755)
    found = write_tree(folder / "robot", {"camera": {}})
    told = found.parent / "told"
    git(found, "init", "--quiet")
    tells = f"id -u >> {told}; cat"
    git(found, "config", "filter.tells.clean", tells)
    git(found, "config", "filter.tells.smudge", tells)
    (found / ".gitattributes").write_text("*.yaml filter=tells\n")
    hook = found / ".git/hooks/pre-commit"
    hook.write_text(f"#!/bin/sh\nid -u >> {told}\n")
    hook.chmod(0o755)
    for path in (folder, *folder.rglob("*")):
        os.chown(path, OTHER, OTHER)
    committed(found, user=OTHER, group=OTHER)
    told.unlink()
    yield found
    shutil.rmtree(folder)


def who_ran(tree: Path) -> set[str]:
    told = tree.parent / "told"
    return set(told.read_text().split()) if told.exists() else set()


@root_only
def test_root_asks_another_users_repository_in_their_name(theirs):
    made = git(theirs, "rev-parse", "HEAD", user=OTHER, group=OTHER)
    assert made.startswith(revision(theirs))
    assert head(theirs).commit == made
    os.utime(theirs / "services/camera.yaml", (1, 1))  # so that git looks at what is in it, through the filter
    assert not head(theirs).dirty
    assert who_ran(theirs) == {str(OTHER)}


@root_only
def test_what_root_changes_in_their_tree_is_theirs(theirs):
    for name, text in (("camera", "a: 1\n"), ("arm", "b: 2\n")):
        change = ManifestChange(f"services/{name}.yaml", None, "", f"Change {name}", "Bob")
        change.carry_out(theirs, theirs.parent / "note", text)
    log = git(theirs, "log", "--format=%an %s", user=OTHER, group=OTHER).splitlines()
    assert log == ["Bob Change arm", "Bob Change camera", "Anna Begin"]
    assert who_ran(theirs) == {str(OTHER)}
    files = [p for p in theirs.rglob("*") if p.lstat().st_uid != OTHER]
    assert not files


@root_only
def test_a_new_folder_in_their_tree_is_theirs(theirs):
    ManifestChange("groups/all.yaml", None, "", "All", "Bob").carry_out(theirs, theirs.parent / "note", "c: 3\n")
    assert {p.stat().st_uid for p in (theirs / "groups", theirs / "groups/all.yaml")} == {OTHER}
    assert commit(theirs, theirs / "groups/all.yaml", "Bob", "Nothing") is False


# -- what is followed ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "url", "branch"),
    [
        ("https://example.org/robot.git", "https://example.org/robot.git", ""),
        ("https://example.org/robot.git@main", "https://example.org/robot.git", "main"),
        ("https://anna:pass@example.org/robot.git", "https://anna:pass@example.org/robot.git", ""),
        ("ssh://git@example.org:22/robot@feature/arm", "ssh://git@example.org:22/robot", "feature/arm"),
        ("git@example.org:robot.git", "git@example.org:robot.git", ""),
        ("git@example.org:robot.git@stable", "git@example.org:robot.git", "stable"),
        ("/srv/robot.git", "/srv/robot.git", ""),
        ("/srv/robot.git@v1.2", "/srv/robot.git", "v1.2"),
        ("file:///srv/robot@main", "file:///srv/robot", "main"),
    ],
)
def test_how_a_repository_and_its_branch_are_named(text, url, branch):
    assert remote(text) == Remote(url, branch)


def test_a_directory_is_named_from_here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot@home").mkdir()
    assert remote("robot@home") == Remote(str(tmp_path / "robot@home"))
    assert remote("robot@home@main") == Remote(str(tmp_path / "robot@home"), "main")


@pytest.mark.parametrize("text", ["", "@main", "robot@", "robot@a..b", "robot@-x", "robot@a b", "--upload-pack=x"])
def test_what_names_no_repository(text):
    with pytest.raises(ValueError, match=r"the repository is missing|is not a valid branch name"):
        remote(text)


def test_who_is_let_in_is_not_shown():
    assert remote("https://anna:pass@example.org/robot").shown == "https://***@example.org/robot"
    assert "pass" not in Followed(remote("https://anna:pass@example.org/robot")).identity
    assert without_user("fatal: https://token@example.org/x: no") == "fatal: https://***@example.org/x: no"


# -- the cache -------------------------------------------------------------------------------------------------


@pytest.fixture
def origin(tmp_path):
    return Origin(tmp_path / "origin")


def cache(tmp_path: Path, url: object, **more) -> GitCache:
    found = GitCache(tmp_path / "git", Followed(Remote(str(url), "main"), **more), threading.Event())
    found.prepare()
    return found


def brought(found: GitCache) -> str:
    commit = found.fetch()
    found.check(commit)
    found.advance(commit)
    return found.commit


def test_what_is_pushed_is_brought(origin, tmp_path):
    first = origin.push("One", {"services/arm.yaml": "a: 1\n", "navigation/map.yaml": "m: 1\n"})
    found = cache(tmp_path, origin.bare)
    assert found.empty
    assert brought(found) == first
    mounted = (found.tree / "navigation").stat().st_ino
    (origin.clone / "services/arm.yaml").unlink()
    second = origin.push("Two", {"navigation/map.yaml": "m: 2\n"})
    assert brought(found) == second
    assert (found.tree / "navigation/map.yaml").read_text() == "m: 2\n"
    assert not (found.tree / "services/arm.yaml").exists()
    assert (found.tree / "navigation").stat().st_ino == mounted, "containers have it mounted"
    assert head(found.tree).commit == second
    assert not head(found.tree).dirty


def test_another_history_is_refused_and_the_last_one_stays(origin, tmp_path):
    origin.push("One")
    found = cache(tmp_path, origin.bare)
    good = brought(found)
    other = origin.push("Another one", {"services/arm.yaml": "x"}, amend=True)
    assert found.fetch() == other
    with pytest.raises(Unacceptable, match="does not follow"):
        found.check(other)
    assert found.commit == good
    assert not (found.tree / "services/arm.yaml").exists()
    git(origin.clone, "reset", "--quiet", "--hard", good)
    second = origin.push("Two")
    assert brought(found) == second


def test_a_commit_without_the_directory_is_refused(origin, tmp_path):
    origin.push("One", {"robots/arm/services/a.yaml": "a: 1\n"})
    found = cache(tmp_path, origin.bare, path="robots/arm")
    brought(found)
    (origin.clone / "elsewhere").symlink_to("/etc")
    shutil.rmtree(origin.clone / "robots/arm")
    (origin.clone / "robots/arm").symlink_to("../elsewhere")
    with pytest.raises(Unacceptable, match="has no directory robots/arm"):
        found.check(origin.push("Two") and found.fetch())


@pytest.mark.parametrize("url", ["gone", "http"])
def test_a_repository_that_is_not_there(origin, tmp_path, url):
    first = origin.push("One")
    where = f"http://anna:secret@127.0.0.1:{free_port()}/robot.git" if url == "http" else str(origin.bare)
    found = cache(tmp_path, origin.bare)
    brought(found)
    origin.bare.rename(tmp_path / "away")
    found.followed = replace(found.followed, remote=Remote(where, "main"))
    with pytest.raises(Unreachable) as told:
        found.fetch()
    assert "secret" not in str(told.value)
    assert ("127.0.0.1" if url == "http" else "origin.git") in str(told.value)
    assert cache(tmp_path, origin.bare).commit == first, "what is there is in force, also for the next one"


def test_another_repository_takes_the_place_of_what_was_there(origin, tmp_path):
    origin.push("One")
    brought(cache(tmp_path, origin.bare))
    assert cache(tmp_path, origin.bare, path="services").commit, "another directory of it is the same repository"
    assert cache(tmp_path, tmp_path / "other.git").empty


@pytest.mark.parametrize("left", ["index.lock", "refs/rorg/fetched.lock", "objects/pack/tmp_pack_x", "HEAD.lock"])
def test_what_a_killed_git_leaves_behind_goes(origin, tmp_path, left):
    origin.push("One")
    found = cache(tmp_path, origin.bare)
    good = brought(found)
    path = found.store / left
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("half")
    (found.tree / "services/camera.yaml").write_text("half")
    again = cache(tmp_path, origin.bare)
    assert again.commit == good
    assert not path.exists()
    assert (again.tree / "services/camera.yaml").read_text() != "half"
    assert brought(again) != origin.push("Two")


def test_a_checkout_that_was_killed_is_ended_by_the_next(origin, tmp_path, monkeypatch):
    origin.push("One", {"services/arm.yaml": "a: 1\n"})
    found = cache(tmp_path, origin.bare)
    brought(found)
    second = origin.push("Two", {"services/arm.yaml": "a: 2\n", "services/leg.yaml": "l: 2\n"})
    found.fetch()
    with monkeypatch.context() as patch:
        patch.setattr(found, "_must", lambda *words: exec_until_reset(found, words))
        with pytest.raises(KeyboardInterrupt):
            found.advance(second)
    (found.tree / "services/leg.yaml").write_text("half of it")
    again = cache(tmp_path, origin.bare)
    assert again.commit == second
    assert (again.tree / "services/leg.yaml").read_text() == "l: 2\n"
    assert (again.tree / "services/arm.yaml").read_text() == "a: 2\n"


def exec_until_reset(found: GitCache, words: tuple[str, ...]) -> None:
    """As if killed when the files are to be written."""
    if words[0] == "reset":
        raise KeyboardInterrupt
    GitCache._must(found, *words)


def test_a_damaged_store_is_made_anew_and_the_files_stay(origin, tmp_path):
    origin.push("One", {"services/arm.yaml": "a: 1\n"})
    found = cache(tmp_path, origin.bare)
    brought(found)
    for path in found.store.glob("objects/pack/*"):
        path.unlink()
    again = cache(tmp_path, origin.bare)
    assert (again.commit, again.empty) == ("", False)
    (origin.clone / "services/arm.yaml").unlink()
    second = origin.push("Two")
    assert brought(again) == second
    assert not (again.tree / "services/arm.yaml").exists()
    assert not again._git("fsck").text


def test_a_fetch_that_is_killed_is_begun_anew(origin, tmp_path):
    """Whoever was told to stop ends its git; one that outlived its rorg is ended by the next."""
    origin.push("One")
    hangs = tmp_path / "hangs"
    hangs.write_text(f"#!/bin/sh\ntouch {tmp_path}/asked\nexec sleep 98764\n")
    hangs.chmod(0o755)
    found = cache(tmp_path, origin.bare)
    orphan = subprocess.Popen(
        ["git", "--git-dir", str(found.store), "fetch", f"--upload-pack={hangs}", str(origin.bare)],
        start_new_session=True,
    )
    wait_for((tmp_path / "asked").exists)
    again = cache(tmp_path, origin.bare)
    orphan.wait(20)
    assert brought(again) == git(origin.clone, "rev-parse", "HEAD")
    again.followed = replace(again.followed, remote=Remote(f"ext::{hangs}", "main"))
    again.stop.set()
    with pytest.raises(Unreachable):
        again.fetch()


# -- signers ---------------------------------------------------------------------------------------------------


@pytest.fixture
def keys(tmp_path):
    """Two ssh keys, and a file in which only Anna's is."""
    for name in ("anna", "eve"):
        make = [tool("ssh-keygen"), "-q", "-t", "ed25519", "-N", "", "-C", name, "-f", str(tmp_path / name)]
        subprocess.run(make, check=True)
    (tmp_path / "signers").write_text(f"anna@example.org {(tmp_path / 'anna.pub').read_text()}")
    return tmp_path


def by(key: Path) -> tuple[str, ...]:
    """Options of git with which a commit is signed."""
    return ("-c", "gpg.format=ssh", "-c", f"user.signingkey={key}", "-c", "commit.gpgsign=true")


def test_only_signed_commits_come_into_force(origin, keys, tmp_path):
    first = origin.push("Signed", None, *by(keys / "anna"))
    found = cache(tmp_path, origin.bare, signers=keys / "signers")
    assert brought(found) == first
    for words, why in (((), "no signature"), (by(keys / "eve"), "No principal matched")):
        origin.push("By somebody else", None, *words)
        with pytest.raises(Unacceptable, match=f"is not signed by any of .*signers: .*{why}"):
            found.check(found.fetch())
    assert found.commit == first
    last = origin.push("Signed again", None, *by(keys / "anna"))
    assert brought(found) == last


def gpg(home: Path, *words: str) -> str:
    command = [
        tool("gpg"),
        "--homedir",
        str(home),
        "--batch",
        "--pinentry-mode",
        "loopback",
        "--passphrase",
        "",
        *words,
    ]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_the_keys_of_a_gnupg_home_count(origin, keys, tmp_path):
    home, trusted = Path(tempfile.mkdtemp(prefix="gpg-")), tmp_path / "trusted"  # a socket's path is short
    try:
        gpg(home, "--quick-gen-key", "anna@example.org", "ed25519", "sign", "never")
        trusted.mkdir(mode=0o700)
        public = tmp_path / "anna.asc"
        public.write_text(gpg(home, "--armor", "--export", "anna@example.org"))
        gpg(trusted, "--import", str(public))
        wraps = tmp_path / "gpg"
        wraps.write_text(f'#!/bin/sh\nexec gpg --homedir {home} --batch --pinentry-mode loopback "$@"\n')
        wraps.chmod(0o755)
        signing = ("-c", f"gpg.program={wraps}", "-c", "user.signingkey=anna@example.org", "-c", "commit.gpgsign=true")
        made = origin.push("Signed", None, *signing)
        assert brought(cache(tmp_path, origin.bare, signers=trusted)) == made
        found = cache(tmp_path, origin.bare, signers=keys / "signers")
        with pytest.raises(Unacceptable, match="is not signed"):
            found.check(made)
        found.followed = replace(found.followed, signers=trusted)
        with pytest.raises(Unacceptable, match="is not signed"):
            found.check(origin.push("By another kind of key", None, *by(keys / "anna")) and found.fetch())
    finally:
        subprocess.run(["gpgconf", "--homedir", str(home), "--kill", "all"])
        subprocess.run(["gpgconf", "--homedir", str(trusted), "--kill", "all"])
        shutil.rmtree(home)


# -- whose configuration counts --------------------------------------------------------------------------------


@root_only
def test_a_repository_of_another_user_is_followed_in_their_name(theirs, tmp_path):
    """Also what their own configuration would run."""
    tells = theirs.parent / "tells"
    tells.write_text(f'#!/bin/sh\nid -u >> {theirs.parent}/told\nexec git pack-objects "$@"\n')
    tells.chmod(0o755)
    for words in (("uploadpack.packObjectsHook", str(tells)), ("core.fsmonitor", str(tells))):
        git(theirs, "config", *words, user=OTHER, group=OTHER)
    branch = git(theirs, "branch", "--show-current", user=OTHER, group=OTHER)
    found = GitCache(tmp_path / "git", Followed(Remote(str(theirs), branch)), threading.Event())
    found.prepare()
    made = git(theirs, "rev-parse", "HEAD", user=OTHER, group=OTHER)
    assert brought(found) == made
    assert "0" not in who_ran(theirs)
    assert head(found.tree).commit == made, "what root keeps of it is root's"


WITHOUT = "--bounding-set=-setuid,-setgid"
"""What a root is like that may not be others, as in a container."""


@root_only
@pytest.mark.parametrize("root", [False, True])
def test_who_may_not_be_them_is_told_what_helps(theirs, root):
    words = "from rorg.host.git import refusal, revision; import sys; from pathlib import Path\n"
    words += "print(repr(revision(Path(sys.argv[1]))), refusal(Path(sys.argv[1])))"
    told = subprocess.run(
        [*((tool("setpriv"), WITHOUT) if root else ()), others.python(), "-c", words, str(theirs)],
        user=None if root else others.STRANGER,
        cwd="/",
        env={"PYTHONPATH": others.IMPORTED, "HOME": "/nowhere", "PATH": os.defpath},
        capture_output=True,
        text=True,
    )
    remedy = f"try `git config --global --add safe.directory {theirs}`"
    assert told.stdout.startswith("'' "), told.stderr
    assert told.stdout.strip().endswith(remedy)


def test_what_is_committed_runs_nothing(origin, tmp_path, monkeypatch):
    """Neither by a filter that whoever runs rorg has, nor by a hook of theirs."""
    ran = tmp_path / "ran"
    (tmp_path / "home/hooks").mkdir(parents=True)
    hook = tmp_path / "home/hooks/post-checkout"
    hook.write_text(f"#!/bin/sh\ntouch {ran}\n")
    hook.chmod(0o755)
    (tmp_path / "home/.gitconfig").write_text(
        f'[filter "tells"]\n\tsmudge = "touch {ran}; cat"\n[core]\n\thooksPath = {hook.parent}\n'
    )
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    origin.push("One", {".gitattributes": "* filter=tells\n"})
    brought(cache(tmp_path, origin.bare))
    assert not ran.exists()


def test_submodules_are_named(origin, tmp_path):
    other = Origin(tmp_path / "other")
    other.push("Other")
    git(origin.clone, "-c", "protocol.file.allow=always", "submodule", "--quiet", "add", str(other.bare), "drivers")
    origin.push("With drivers")
    found = cache(tmp_path, origin.bare)
    brought(found)
    assert found.submodules() == ["drivers"]
    assert list((found.tree / "drivers").iterdir()) == []
