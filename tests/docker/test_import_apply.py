"""An imported Compose project on Docker: what runs is what Compose would run, and `rorg down` leaves nothing of it."""

from __future__ import annotations

import json
import os
import shutil

import agreement
import docker
import pytest
from commands import rorg
from common import BASE_IMAGE
from compose_cases import CASES

CASE = CASES / "whole_robot"


@pytest.fixture
def folder(dockerd, tmp_path, monkeypatch):
    found = tmp_path / CASE.name
    shutil.copytree(CASE, found)
    monkeypatch.setenv("DOCKER_HOST", dockerd.host)
    monkeypatch.setenv("RORG_STATE_DIR", str(tmp_path / "state"))
    api = docker.APIClient(dockerd.host, version="auto")
    agreement.make_images(api, [])
    api.tag(BASE_IMAGE, "lab/python", "1")
    yield found
    if (tmp_path / "state").is_dir():
        rorg("down", "--volumes", "--yes", cwd=found)


@pytest.mark.docker
def test_an_imported_project_runs_as_compose_runs_it(dockerd, folder):
    rorg("import", "compose", cwd=folder)
    rorg("validate", "manifests", cwd=folder)
    rorg("apply", "manifests", "--yes", "--wait", cwd=folder)
    assert rorg("diff", "manifests", cwd=folder).returncode == 0
    compose = json.loads((CASE / "inspect.json").read_text())
    api = docker.APIClient(dockerd.host, version="auto")
    running = {c["Names"][0].lstrip("/"): c["State"] for c in api.containers(all=True) if CASE.name in c["Names"][0]}
    names = {f"{CASE.name}-{name}-1": "running" for name in ("broker", "nav", "agent")}
    assert {n: running.get(n) for n in names} == names
    assert running[f"{CASE.name}-job-1"] == "exited"
    made = agreement.project(api, running, compose["config"], folder)
    recorded = {n: c for n, c in compose["containers"].items() if n in running}
    assert agreement.differences(recorded, made["containers"]) == []
    assert agreement.differences(compose["networks"], made["networks"]) == []
    assert agreement.differences(compose["volumes"], made["volumes"]) == []
    rorg("down", "--volumes", "--yes", cwd=folder)
    assert not [n for n in api.networks() if CASE.name in n["Name"]]
    assert not [v for v in api.volumes()["Volumes"] or () if CASE.name in v["Name"]]
    assert os.path.isdir(folder / "config")
