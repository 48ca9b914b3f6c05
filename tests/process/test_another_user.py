"""Another Unix user beside a running rorg: a member of its group has the socket and nothing else, and every command
works; nobody else may, and is told how to."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest
from command_samples import SAMPLES
from common import wait_for
from other_users import GROUP, IMPORTED, MEMBER, STRANGER, python
from rorg_process import RorgProcess

from rorg.cli.commands import COMMANDS

SERVICES = {
    "roscore": {},
    "navigation": {"needs": ["roscore"]},
    "base": {"always_on": True, "driver": {"groups": ["dialout"]}},
}
LINES = {name: sample.member for name, sample in SAMPLES.items()}
"""What a member says, command by command; `down` comes last."""
CODES = {
    "import roslaunch nosuch.launch": {2},
    "run nowhere": {2},
    "emulate nosuch.yaml": {2},
    "simulate nosuch.yaml robot": {2},
    "fleet status nosuch.yaml": {2},
    "ui --no-browser --port 99999": {2},
    "plot usage -o usage.gif": {2},
    "take base --yes": {5},
    "take nosuch --yes": {2},
    "diff {tree}": {0, 1},
    "retry base": {5},
    "retry base --yes": {5},
    "edit base": {2},
    "exec base -- true": {5},
    "shell base": {5},
    "cp base:/etc/hostname .": {5},
    "dev base": {5},
    "dev": {5},
    "image list": {5},
    "rollback --print": {5},
    "restore --at 10m": {5},
}
"""Exit codes other than 0: what goes to the engine is refused with the reason, and an editor wants a terminal."""


class Shared:
    """A robot of root's, of which others see a socket; and the homes of two users."""

    def __init__(self, folder: Path) -> None:
        folder.chmod(0o755)
        self.folder, self.run = folder, folder / "run"
        self.socket = self.run / "rorg.sock"
        self.python = python()
        private = folder / "private"
        private.mkdir(mode=0o700)
        groups = {"driving": {"services": ["navigation"]}}
        self.robot = RorgProcess(private, SERVICES, "--group", str(GROUP), groups=groups)
        self.robot.start(env={**os.environ, "RORG_RUN_DIR": str(self.run)})
        self.robot.state.mkdir(mode=0o750, exist_ok=True)
        for user in (MEMBER, STRANGER):
            (folder / str(user)).mkdir()
            os.chown(folder / str(user), user, user)

    def rorg(
        self,
        line: str,
        user: int = MEMBER,
        group: int = GROUP,
        more: tuple[int, ...] = (),
        place: Path | None = None,
        **environment: str,
    ):
        home = self.folder / str(user)
        clean = {"PATH": os.defpath, "HOME": str(home), "TERM": "dumb", "LANG": "C.UTF-8", "PYTHONPATH": IMPORTED}
        return subprocess.run(
            [self.python, "-m", "rorg", *shlex.split(line.format(tree=self.robot.tree))],
            user=user,
            group=group,
            extra_groups=list(more),
            cwd=place or home,
            env={**clean, **environment},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=120,
        )


@pytest.fixture(scope="module")
def shared():
    if os.geteuid() != 0:
        pytest.skip("only root can be another user")
    folder = Path(tempfile.mkdtemp(prefix="rorg-shared-"))
    found = Shared(folder)
    try:
        wait_for(lambda: found.rorg("wait base", RORG_SOCKET=str(found.socket)).returncode == 0, what="its base")
        yield found
    finally:
        found.robot.close()
        shutil.rmtree(folder)


def test_every_command_has_a_line():
    assert set(LINES) == set(COMMANDS)


@pytest.mark.slow
@pytest.mark.parametrize("line", [line for name in LINES if name != "down" for line in LINES[name]])
def test_a_member_needs_nothing_but_the_socket(shared, line):
    if " robot" in line and line != "init robot" and not (shared.folder / str(MEMBER) / "robot").exists():
        shared.rorg("init robot")
    done = shared.rorg(line, RORG_SOCKET=str(shared.socket))
    told = done.stdout + done.stderr
    assert done.returncode in CODES.get(line, {0}), told
    assert "internal error" not in told
    assert "Permission denied" not in told, "it looked where it needs not"
    if done.returncode == 5 and not line.startswith(("retry", "rollback", "restore", "take")):
        assert "only the socket" in told


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "environment"),
    [
        ("get --socket {socket}", {}),
        ("get --socket {socket}", {"RORG_SOCKET": "/nowhere/rorg.sock"}),
        ("get", {"RORG_SOCKET": "unix://{socket}"}),
        ("get", {"RORG_ADDRESS": "unix://{socket}"}),
        ("get", {"RORG_RUN_DIR": "{run}"}),
        ("get --state-dir {state}", {"RORG_RUN_DIR": "{run}", "RORG_SOCKET": "/nowhere/rorg.sock"}),
        ("get", {"RORG_RUN_DIR": "{run}", "RORG_STATE_DIR": "{state}"}),
    ],
    ids=str,
)
def test_what_names_the_robot(shared, line, environment):
    names = {"socket": shared.socket, "run": shared.run, "state": shared.robot.state}
    done = shared.rorg(line.format(**names), **{k: v.format(**names) for k, v in environment.items()})
    assert done.returncode == 0, done.stderr
    assert "base" in done.stdout


def test_the_groups_of_a_process_count(shared):
    """Also of one whose user stands in no file of the machine, such as a service of systemd's."""
    done = shared.rorg("request navigation --id other", MEMBER, MEMBER, (GROUP,), RORG_SOCKET=str(shared.socket))
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("line", ["get", "why base", "request base", "wait base", "diff", "top --once", "down --yes"])
def test_who_is_not_in_the_group_is_told_so(shared, line):
    done = shared.rorg(line, STRANGER, STRANGER, RORG_RUN_DIR=str(shared.run))
    assert done.returncode == 5, done.stderr
    assert done.stderr == (
        f"rorg: cannot talk to rorg at {shared.socket}: you are not in the group {GROUP}; "
        f"try `sudo usermod -aG {GROUP} $USER` and log in again\n"
    )


@pytest.mark.slow
@pytest.mark.parametrize("line", ["wait base", "top --once", "events -f", "request base --wait"])
def test_where_no_rorg_runs_it_says_how_to_get_one(shared, line):
    state = shared.folder / str(STRANGER) / "state"
    done = shared.rorg(f"{line} --state-dir {state}", STRANGER, STRANGER)
    assert done.returncode == 3, done.stderr
    assert f"no rorg runs on {state}; start one with `rorg run`, or name another with --state-dir" in done.stderr


def test_a_state_directory_that_nobody_serves_and_one_may_not_read(shared):
    done = shared.rorg(f"wait base --state-dir {shared.robot.state}", STRANGER, STRANGER)
    assert done.returncode == 3, done.stderr
    assert f"you may not read {shared.robot.state}" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("line", ["get", "get requests", "validate", "diff"])
def test_a_working_directory_that_one_may_not_enter(shared, line):
    """As that of root, after `sudo -u`."""
    state = shared.folder / str(STRANGER) / "state"
    done = shared.rorg(f"{line} --state-dir {state}", STRANGER, STRANGER, place=shared.folder / "private")
    assert done.returncode in (0, 2, 3), done.stderr
    assert "internal error" not in done.stderr


def test_one_place_is_named(shared):
    done = shared.rorg("get --socket x --state-dir y")
    assert (done.returncode, "--socket and --state-dir each name one" in done.stderr) == (2, True), done.stderr


def test_a_group_that_there_is_not(shared):
    done = shared.rorg(f"run --group no-such-group --state-dir {shared.folder / str(STRANGER)}", STRANGER, STRANGER)
    assert done.returncode == 2
    assert "cannot let the group 'no-such-group' in" in done.stderr


def test_a_member_takes_the_robot_down(shared):
    for line in LINES["down"]:
        done = shared.rorg(line, RORG_SOCKET=str(shared.socket))
        assert done.returncode == 0, done.stderr
    assert shared.robot.process.wait(60) == 0
