"""`rorg build` as somebody types it: what it says, what it leaves, and its exit codes."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from commands import rorg
from common import BASE_IMAGE, wait_for
from robots import write_tree

from rorg.cli.terminal import printable


@pytest.fixture
def tree(tmp_path):
    """A robot of two images that can be built and one that cannot."""
    write_tree(tmp_path / "tree", {"camera": {}})
    (tmp_path / "tree/images").mkdir()
    for name, text in {
        "bad": "FROM scratch\nCOPY nothing /x",
        "one": f"LABEL a={tmp_path}",
        "two": f"LABEL c={tmp_path}",
    }.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "Dockerfile").write_text(text if "FROM" in text else f"FROM {BASE_IMAGE}\n{text}\n")
        manifest = {"apiVersion": "rorg/v1", "kind": "Image", "metadata": {"name": name}}
        text = json.dumps({**manifest, "spec": {"context": f"../../{name}"}})
        (tmp_path / f"tree/images/{name}.yaml").write_text(text)
    return tmp_path / "tree"


def of(tree: Path, dockerd=None) -> dict[str, str]:
    """Where rorg finds its engine and its state."""
    where = {"DOCKER_HOST": dockerd.host} if dockerd else {"RORG_ENGINE": "process"}
    return {"RORG_STATE_DIR": str(tree.parent / "state"), **where}


def test_the_command_says_what_failed_where_its_log_is_and_builds_the_rest(dockerd, place, tree):
    done = rorg("build", "--manifests", str(tree), "-o", "json", code=4, **of(tree, dockerd))
    rows = {row["image"]: row for row in json.loads(done.stdout)}
    assert {name: row["outcome"] for name, row in rows.items()} == {
        **dict.fromkeys(("one", "two"), "built"),
        "bad": "failed",
        BASE_IMAGE: "present",
    }
    place.builder().remove(["one", "two"])
    assert f"bad failed at {rows['bad']['step']}: {rows['bad']['message']}" in done.stderr
    assert f"all of it: {tree.parent}/state/builds/bad-" in done.stderr
    said = [line.strip() for line in Path(rows["bad"]["log"]).read_text().splitlines()]
    assert [line.removeprefix("  | ").strip() for line in done.stderr.splitlines() if line.startswith("  | ")] == [
        printable(line) for line in said[-10:]
    ]
    assert "cannot build all images: 1 of 4 failed or were skipped: bad; fix the first one" in done.stderr
    one = rorg("build", "one", "--manifests", str(tree), **of(tree, dockerd))
    assert one.stderr.endswith(" images are there\n")
    place.builder().remove(["one"])


@pytest.mark.slow
def test_what_would_be_done_is_printed_and_nothing_is_done(tree):
    words, noted = ["--manifests", str(tree), "--dry-run", "-o"], tree.parent / "state" / "process-images.json"
    told = {row["image"]: row["action"] for row in json.loads(rorg("build", *words, "json", **of(tree)).stdout)}
    assert told == {**dict.fromkeys(("bad", "one", "two"), "build"), BASE_IMAGE: "nothing"}
    assert not noted.exists()
    assert "two" in rorg("build", "two", *words, "name", **of(tree)).stdout.splitlines()
    rorg("build", "two", "--manifests", str(tree), **of(tree))
    assert json.loads(noted.read_text())["two"] == [str(tree.parent / "two")]


@pytest.mark.slow
def test_processes_have_nothing_to_pull(tree):
    words = ("build", "two", "--manifests", str(tree), "-o", "json")
    for more in ((), ("--pull",)):
        rows = {row["image"]: row["outcome"] for row in json.loads(rorg(*words, *more, **of(tree)).stdout)}
        assert rows == {"two": "present" if more else "built", **({} if more else {BASE_IMAGE: "present"})}


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_build_that_is_interrupted_leaves_nothing_under_way(dockerd, place, tree, number, code):
    sleep = "RUN python3 -S -c 'import time; time.sleep(600)'"
    (tree.parent / "one/Dockerfile").write_text(f"FROM {BASE_IMAGE}\n{sleep}\n")
    line = [sys.executable, "-m", "rorg", "build", "one", "--manifests", str(tree)]
    begun = subprocess.Popen(line, stderr=subprocess.PIPE, text=True, env={**os.environ, **of(tree, dockerd)})
    wait_for(lambda: "time.sleep" in (begun.stderr.readline() or pytest.fail("it has ended")), 120, "its step")
    begun.send_signal(number)
    left = begun.communicate(timeout=60)[1].splitlines()
    assert (begun.returncode, len(left)) == (code, 1), left
    assert re.fullmatch(r"failed   one \([0-9.]+ s\): stopped", left[0])
    wait_for(lambda: not place.running(), 60, "the engine to end what it runs")


def test_on_a_terminal_lines_are_rewritten_in_place(dockerd, place, tree):
    ours, its = pty.openpty()
    line = [sys.executable, "-m", "rorg", "build", "one", "--manifests", str(tree)]
    environment = {**os.environ, **of(tree, dockerd), "TERM": "xterm-256color", "COLUMNS": "90"}
    begun = subprocess.Popen(line, stdin=its, stdout=its, stderr=its, env=environment)
    os.close(its)
    text = b""
    with contextlib.suppress(OSError):  # its end
        while chunk := os.read(ours, 4096):
            text += chunk
    os.close(ours)
    assert begun.wait(60) == 0, text
    assert b"built    one (" in text
    assert text.rstrip().endswith(b" images are there")
    place.builder().remove(["one"])
