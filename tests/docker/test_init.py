"""`rorg init` writes a robot that runs as it is, on both engines; `rorg schema` what editors check it by."""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path

import commands
import jsonschema
import pytest
import yaml
from busybox import build_busybox
from common import wait_for

from rorg.manifest.models import SPECS

IDENTITY = {
    "GIT_AUTHOR_NAME": "somebody",
    "GIT_AUTHOR_EMAIL": "somebody@localhost",
    "GIT_COMMITTER_NAME": "somebody",
    "GIT_COMMITTER_EMAIL": "somebody@localhost",
}


def rorg(folder: Path, *words: str, code: int = 0, **environment: str) -> subprocess.CompletedProcess[str]:
    environment = {**IDENTITY, "RORG_STATE_DIR": str(folder / "state"), **environment}
    return commands.rorg(*words, code=code, cwd=folder, **environment)


TEMPLATES = pytest.mark.parametrize(("template", "count"), [("first", 3), ("ros2", 5)])


@pytest.mark.slow
@TEMPLATES
def test_it_is_valid_and_in_git(tmp_path, template, count):
    rorg(tmp_path, "init", "robot", "--template", template)
    robot = tmp_path / "robot"
    assert f"{count} services" in rorg(tmp_path, "validate", "robot").stderr
    status = subprocess.check_output(["git", "-C", robot, "status", "--porcelain"], text=True)
    tracked = subprocess.check_output(["git", "-C", robot, "ls-files"], text=True).split()
    assert not status
    assert {".gitignore", "README.md", "schemas/service.json"} <= set(tracked)
    assert len([path for path in tracked if path.startswith("services/")]) == count
    assert not [path for path in robot.rglob("*") if path.is_symlink() or path.suffix == ".pyc"]


@pytest.mark.slow
@TEMPLATES
def test_its_manifests_agree_with_the_schemas_that_they_name(tmp_path, template, count):
    rorg(tmp_path, "init", "robot", "--template", template)
    paths = sorted((tmp_path / "robot").glob("*/*.yaml"))
    assert len(paths) >= count
    for path in paths:
        head = path.read_text().splitlines()[0]
        schema = path.parent / head.partition("$schema=")[2]
        jsonschema.validate(yaml.safe_load(path.read_text()), json.loads(schema.read_text()))


def test_vs_code_finds_a_schema_for_each_kind(tmp_path):
    rorg(tmp_path, "init", "robot")
    found = json.loads((tmp_path / "robot/.vscode/settings.json").read_text())["yaml.schemas"]
    assert all((tmp_path / "robot" / schema).exists() for schema in found)
    of_manifests = {kind.lower() for kind in SPECS} - {"trace", "workload"}
    assert {Path(schema).stem for schema in found} == of_manifests
    tracked = subprocess.check_output(["git", "-C", tmp_path / "robot", "ls-files"], text=True).split()
    assert ".vscode/settings.json" in tracked


@pytest.mark.slow
@TEMPLATES
def test_what_its_comments_offer_is_accepted(tmp_path, template, count):
    """Each commented field, with its comment sign taken away."""
    rorg(tmp_path, "init", "robot", "--template", template)
    offered = 0
    for path in sorted((tmp_path / "robot/services").glob("*.yaml")):
        text = path.read_text()
        for line in text.splitlines():
            plain = re.sub(r"^( +)# (?=\w+:)", r"\1", line)
            if plain != line:
                path.write_text(text.replace(line, plain))
                assert f"{count} services" in rorg(tmp_path, "validate", "robot").stderr, plain
                path.write_text(text)
                offered += 1
    assert offered


def test_it_goes_where_it_stands(tmp_path):
    """Into the repository that is there; without git, or somebody who commits, it goes too."""
    subprocess.run(["git", "init", "--quiet", tmp_path], check=True)
    rorg(tmp_path, "init", "robots/one")
    assert not (tmp_path / "robots/one/.git").exists()
    done = rorg(tmp_path, "init", "two", PATH="/nowhere")
    assert "git" not in done.stderr
    assert (tmp_path / "two/services/base.yaml").exists()


@pytest.mark.parametrize("there", ["README.md", "services/base.yaml", "schemas"])
def test_it_overwrites_nothing(tmp_path, there):
    mine = tmp_path / "robot" / there
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    assert there in rorg(tmp_path, "init", "robot", code=5).stderr
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [mine]
    assert mine.read_text() == "mine"


@pytest.mark.parametrize("there", ["services/x.yaml", "compose.yaml", "groups/all.yml"])
def test_it_refuses_a_directory_with_manifests(tmp_path, there):
    """A robot with them would not be the one that it promises, and might be invalid."""
    mine = tmp_path / "robot" / there
    mine.parent.mkdir(parents=True)
    mine.write_text("kind: [")
    refused = rorg(tmp_path, "init", "robot", code=5).stderr
    assert f"{there} would belong to the robot" in refused
    assert "; try another directory" in refused
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [mine]


@pytest.mark.parametrize("machines", ["1", "2"])
def test_it_commits_nothing_else(tmp_path, machines):
    mine = [tmp_path / "robot" / name for name in ("services/notes.txt", ".vscode/mine.json", "machines/x", "run.py")]
    for path in mine:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
    subprocess.run(["git", "init", "--quiet", tmp_path / "robot"], check=True)
    subprocess.run(["git", "-C", tmp_path / "robot", "add", "run.py"], check=True)
    rorg(tmp_path, "init", "robot", "--machines", machines)
    git = ["git", "-C", tmp_path / "robot"]
    tracked = subprocess.check_output([*git, "ls-tree", "-r", "--name-only", "HEAD"], text=True).split()
    there = {str(p.relative_to(tmp_path / "robot")) for p in (tmp_path / "robot").rglob("*") if p.is_file()}
    there = {path for path in there if not path.startswith(".git/")}
    assert there - set(tracked) == {str(p.relative_to(tmp_path / "robot")) for p in mine}
    assert "services/base.yaml" in tracked


def test_without_an_identity_it_names_a_command_that_commits_its_files_alone(tmp_path):
    (tmp_path / "robot").mkdir()
    subprocess.run(["git", "init", "--quiet", tmp_path / "robot"], check=True)
    mine = tmp_path / "robot/run.py"
    git = ["git", "-C", tmp_path / "robot", "-c", "user.name=a", "-c", "user.email=a@b"]
    mine.write_text("mine")
    subprocess.run([*git, "add", "run.py"], check=True)
    subprocess.run([*git, "commit", "--quiet", "--message", "mine"], check=True)
    mine.write_text("not yet")
    nobody = {"GIT_AUTHOR_EMAIL": "", "GIT_COMMITTER_EMAIL": "", "GIT_CONFIG_GLOBAL": "/dev/null"}
    nobody |= {"GIT_AUTHOR_NAME": "", "GIT_COMMITTER_NAME": ""}
    told = rorg(tmp_path, "init", "robot", **nobody).stderr
    command = re.search(r"commit it: `(.*)`", told)
    assert command, told
    subprocess.run(command[1], shell=True, check=True, cwd=tmp_path, env={**os.environ, **IDENTITY})
    status = subprocess.check_output([*git, "status", "--porcelain"], text=True)
    assert status.strip() == "M run.py"


@pytest.mark.slow
def test_schemas_are_written_anew(tmp_path):
    rorg(tmp_path, "init", "robot")
    stale = tmp_path / "robot/schemas/service.json"
    stale.write_text("{}")
    assert "service.json" in rorg(tmp_path / "robot", "schema").stderr
    assert len(stale.read_text()) > 1000
    (tmp_path / "file").touch()
    assert "file" in rorg(tmp_path, "schema", "file/schemas", code=2).stderr


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["process", pytest.param("docker", marks=pytest.mark.docker)])
def test_it_runs_as_it_is(tmp_path, request, engine):
    environment = {"RORG_ENGINE": engine}
    if engine == "docker":
        environment["DOCKER_HOST"] = request.getfixturevalue("dockerd").host
        build_busybox(environment["DOCKER_HOST"], tmp_path / "image")
    rorg(tmp_path, "init", "robot", **environment)
    run = commands.Forked(["run", "robot", "--state-dir", "state"], {**os.environ, **environment}, tmp_path)
    try:
        wait_for(lambda: (tmp_path / "state/run/rorg.sock").exists())
        rorg(tmp_path, "request", "navigation", "--wait", **environment)
        assert "map loaded" in rorg(tmp_path, "logs", "localization", **environment).stdout
        states = json.loads(rorg(tmp_path, "get", "-o", "json", **environment).stdout)
        assert {s["service"]: s["health"] for s in states if s["state"] != "meta"} == dict.fromkeys(
            ("base", "localization", "navigation"), "Healthy"
        )
        rorg(tmp_path, "down", "--yes", **environment)
        assert run.wait(30) == 0
        assert {p.name for p in (tmp_path / "state").iterdir()} - {"journal.db-shm", "journal.db-wal"} == {
            *("instance", "requests.yaml", "journal.db")
        }
    finally:
        run.kill()
        run.wait()
