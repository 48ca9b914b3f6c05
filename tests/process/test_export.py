"""`rorg export compose`: the robot as a Compose file that Compose accepts, with nothing dropped in silence."""

from __future__ import annotations

import json
import shutil
from dataclasses import fields

import pytest
import yaml
from commands import rorg
from common import ROOT
from finding_cases import build

from rorg.manifest.container import ContainerOptions
from rorg.model.catalog import Image, Service
from rorg.tools.compose.writer import dotenv, project
from rorg.tools.compose.writer_notes import SERVICE
from rorg.tools.compose.writer_options import OPTIONS, beside

CASE = ROOT / "tests/cases/export/robot"
"""A robot with every option. `compose.yaml` is what is written of it; Compose 2.26.1 takes it, and answers what stands
in `config.json` to `docker compose config --format json`, with paths relative to the case."""

CARRIED = {
    *("name", "context", "dockerfile", "args", "target", "platform", "stand_ins", "cache_from", "inline", "secrets"),
}
"""Fields of an Image that the file contains; `import_command` has a note."""
DERIVED = {"directory", "where", "bases", "reference"}
"""Fields that follow from others."""
ELSEWHERE = {
    *("name", "spec", "needs", "joins", "restarts_with", "restart", "secrets", "description"),
    *("meta", "cpu", "memory", "driver", "unplugged", "defaults", "origins", "where", "domain", "away"),
}
"""Fields of a Service that the file contains, or that another field's row covers."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("exported") / "robot"
    shutil.copytree(CASE / "manifests", found / "manifests")
    rorg("export", "compose", "manifests", "--output", "compose.yaml", cwd=found)
    return found


def test_every_option_has_a_row():
    there = set(ContainerOptions.model_fields) - {"env_file"} | {"image", "command", "inherit_environment"}
    assert set(OPTIONS) == there


def test_every_field_of_a_service_has_a_row():
    rows = {name for name, _ in SERVICE} - {"resources"}  # which are `cpu` and `memory`
    assert rows | ELSEWHERE == {field.name for field in fields(Service)}
    assert not rows & ELSEWHERE


def test_every_field_of_an_image_is_carried_or_has_a_note():
    assert CARRIED | DERIVED | {"import_command"} == {field.name for field in fields(Image)}


def test_the_file_is_the_one_that_compose_takes(folder):
    assert (folder / "compose.yaml").read_text() == (CASE / "compose.yaml").read_text()


def test_what_compose_reads_in_it_is_what_the_manifests_say(folder):
    """Of what Compose answered: every option that is in the file is in it, and `$` stands for itself."""
    read = json.loads((CASE / "config.json").read_text())["services"]
    written = yaml.safe_load((folder / "compose.yaml").read_text())["services"]
    assert read.keys() | {"image-base"} == written.keys()
    for name, section in read.items():
        assert written[name].keys() - {"external_links", "env_file"} <= section.keys()
    assert read["every"]["command"] == ["sh", "-c", "echo $$HOME $${NOT_OURS} 100%"]
    assert read["every"]["environment"]["PASSWORD"] == 'a\'b "c" $$d'
    assert read["every"]["environment"]["NUMBER"] == "1e3"
    assert read["every"]["environment"]["OCTAL"] == "0o17"


def test_secrets_are_in_a_file_of_their_own(folder):
    secret = folder / "every.env"
    assert secret.stat().st_mode & 0o777 == 0o600
    assert "a'b" not in (folder / "compose.yaml").read_text()
    assert secret.read_text() == 'PASSWORD="a\'b \\"c\\" \\$d"\n'


def test_a_profile_of_seccomp_is_a_file(folder):
    assert json.loads((folder / "every.seccomp.json").read_text()) == {"defaultAction": "SCMP_ACT_ALLOW"}


def test_parameters_of_ros2_are_a_file_that_the_container_mounts(tmp_path):
    spec = """image: ros:jazzy
command: ros2 run nav2_amcl amcl
profile: ros2
ros: {parameters: {/amcl/laser/max_range: 12.0, /amcl/rate: 5}, remap: {scan: /front}}
"""
    build(tmp_path / "manifests", {"amcl": spec})
    told = rorg("export", "compose", "manifests", "--output", "compose.yaml", cwd=tmp_path)
    assert "${rorg.run}" not in (tmp_path / "compose.yaml").read_text()
    service = yaml.safe_load((tmp_path / "compose.yaml").read_text())["services"]["amcl"]
    assert service["volumes"] == ["./amcl.parameters.yaml:/ros-parameters.yaml:ro"]
    assert service["command"][-5:] == ["--ros-args", "--remap", "scan:=/front", "--params-file", "/ros-parameters.yaml"]
    written = yaml.safe_load((tmp_path / "amcl.parameters.yaml").read_text())
    assert written == {
        "/amcl": {"ros__parameters": {"rate": 5}},
        "/amcl/laser": {"ros__parameters": {"max_range": 12.0}},
    }
    assert "sets no parameters" not in told.stderr


def test_nothing_that_is_there_is_written_over(folder):
    told = rorg("export", "compose", "manifests", "--output", "compose.yaml", cwd=folder, code=5)
    assert "compose.yaml" in told.stderr
    assert "every.env" in told.stderr
    rorg("export", "compose", "manifests", "--output", "compose.yaml", "--force", cwd=folder)


def test_programs_read_what_is_lost(folder):
    told = json.loads(rorg("export", "compose", "manifests", "-o", "json", cwd=folder).stdout)
    assert told["compose"] == yaml.safe_load((folder / "compose.yaml").read_text())
    assert {"every.env", "every.seccomp.json"} == set(told["files"])
    lost = {(n["service"], n["field"]) for n in told["notes"] if n["carried"] == "not carried"}
    assert {("every", "spec.container.masked_paths"), ("camera", "spec.idle"), ("", "Request")} <= lost
    assert ("every", "spec.secrets") not in lost


def test_another_format_is_refused(folder):
    told = rorg("export", "helm", "manifests", cwd=folder, code=2).stderr
    assert "invalid value for 'FORMAT': 'helm' is not one of 'compose'" in told


@pytest.mark.parametrize(
    ("path", "written"),
    [
        ("/a/b/c/d", "./c/d"),
        ("/a/b", "."),
        ("/a/x/y", "../x/y"),
        ("/a", ".."),
        ("/x", "/x"),
        ("./here", "./here"),
    ],
)
def test_paths_are_relative_where_they_lie_beside_the_file(path, written):
    assert beside(path, "/a/b") == written


@pytest.mark.parametrize(("name", "allowed"), [("My Robot", "my-robot"), ("_x", "x"), ("...", "robot"), ("a.b", "a-b")])
def test_names_of_projects(name, allowed):
    assert project(name) == allowed


@pytest.mark.parametrize(
    ("value", "written"),
    [
        ("a:b/c", "a:b/c"),
        ("a b", "'a b'"),
        ("it's $x", '"it\'s \\$x"'),
        ("a\nb", '"a\\nb"'),
        ("", ""),
        ("a#b", "'a#b'"),
    ],
)
def test_values_are_quoted_where_they_must_be(value, written):
    assert dotenv({"A": value}) == f"A={written}\n"
