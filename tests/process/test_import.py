"""`rorg import` as a command: what it writes, what it says, and its exit codes."""

from __future__ import annotations

import json
import os

import commands


def test_everything_that_cannot_be_is_told_at_once_and_nothing_is_written(tmp_path):
    (tmp_path / "Dockerfile").write_text("FROM busybox\n")
    (tmp_path / "compose.yaml").write_text(
        "services:\n  nav:\n    image: a\n    external_links: [x]\n    build: {context: ., ssh: [default]}\n"
        "    post_start: [{command: a}]\n  developer: {image: b}\n  _x: {image: c}\n"
    )
    done = commands.run(["import", "compose"], dict(os.environ), tmp_path)
    assert done.returncode == 2
    for place, what in {
        "4:5": "external_links cannot be carried over",
        "5:25": "build.ssh cannot be carried over",
        "6:5": "post_start cannot be carried over",
        "7:3": "'developer' names a person in rorg",
        "8:3": "'_x' is not a valid name of a service in rorg",
    }.items():
        assert f"compose.yaml:{place}: error: {what}" in done.stderr
    assert not (tmp_path / "manifests").exists()


def test_the_command_writes_what_validate_takes_and_says_what_is_otherwise(tmp_path):
    (tmp_path / "robot.yaml").write_text(
        "name: bot\nservices:\n  nav: {image: 'a:${TAG:?}', pull_policy: always, profiles: [x]}\n"
    )
    (tmp_path / "over.yaml").write_text("services: {nav: {tty: true}}\n")
    (tmp_path / "lab.env").write_text("TAG=7\n")
    line = "import compose robot.yaml over.yaml --env-file lab.env --profile x --project-name lab --output m -o json"
    done = commands.run(line.split(), dict(os.environ), tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert "m/services/nav.yaml" in found["files"]
    assert [d["message"].partition(":")[0] for d in found["diagnostics"]] == ["pull_policy is not carried over"]
    text = (tmp_path / "m/services/nav.yaml").read_text()
    assert "image: a:7\n" in text
    assert "container_name: lab-nav-1 " in text
    assert "tty: true" in text
    assert (tmp_path / "m/requests/compose.yaml").exists()
    assert commands.run(["validate", "m"], dict(os.environ), tmp_path).returncode == 0
