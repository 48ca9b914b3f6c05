"""A robot whose manifests are rolled back, and how its revisions stand."""

from __future__ import annotations

import os
import subprocess

import commands
from common import wait_for

from rorg.history.database import reading
from rorg.history.revisions import Revisions

ANN = {
    "GIT_AUTHOR_NAME": "Ann",
    "GIT_AUTHOR_EMAIL": "ann@lab",
    "GIT_COMMITTER_NAME": "Ann",
    "GIT_COMMITTER_EMAIL": "ann@lab",
}


def git(robot, *words: str) -> str:
    return subprocess.check_output(["git", "-C", robot.tree, *words], text=True, env={**os.environ, **ANN}).strip()


def rorg(robot, *words: str, code: int = 0, **environment: str) -> str:
    """What was said."""
    environment = {"RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "process", **ANN, **environment}
    done = commands.rorg(*words, code=code, cwd=robot.tree.parent, **environment)
    return done.stdout + done.stderr


def revisions(robot) -> list:
    """The newest first."""
    with reading(robot.state.journal) as database:
        return Revisions(database).list(100)


def stands(robot, commit: str, standing: str) -> None:
    """Waits until a commit is on record with a standing."""
    what = f"{standing} {commit}"
    wait_for(lambda: any((r.commit, r.standing) == (commit, standing) for r in revisions(robot)), what=what)
