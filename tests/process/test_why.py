"""What rorg says of a service in a situation is so: each case makes the situation, and reads the sentence."""

# ruff: noqa: F811 - a fixture is a parameter

from __future__ import annotations

import pytest
from cli_shell import shell  # noqa: F401
from common import wait_for
from robots import write_tree


def begin(shell, **services: dict) -> None:
    write_tree(shell.tree, {"base": {"always_on": True}, **services})
    shell.run()


def why(shell, name: str) -> list[str]:
    return [line.strip() for line in shell("why", name).stdout.splitlines()]


@pytest.mark.slow
def test_a_held_service_is_not_restarted_because_it_is_held(shell):
    begin(shell, arm={})
    shell("request", "arm", "--wait")
    shell("hold", "arm", "--for", "10m", "--reason", "wiring", "--yes")
    said = shell("restart", "arm", code=5).stderr
    assert "wiring" in said
    assert "`rorg hold arm --end`" in said


@pytest.mark.slow
def test_what_a_suspension_keeps_from_starting_says_so(shell):
    begin(shell, arm={})
    shell("suspend", "--for", "10m", "--reason", "lunch")
    shell("request", "arm")
    wait_for(lambda: any("suspended until" in line for line in why(shell, "arm")))
    lines = why(shell, "arm")
    assert any(line.endswith(": lunch") for line in lines)
    assert lines[-1] == "to let it in: `rorg suspend --end`"
    assert "suspended" not in "".join(why(shell, "base")), "it runs, and nothing is to be done about it"
    shell("suspend", "--end")
    shell("wait", "arm")


@pytest.mark.slow
def test_a_task_that_is_done_has_completed(shell):
    begin(shell, job={"restart": "never", "command": ["true"]})
    shell("request", "job", "--wait")
    wait_for(lambda: why(shell, "job")[0] == "job has completed, and is wanted:")


@pytest.mark.slow
def test_what_lingers_says_so_once(shell):
    begin(shell, arm={"idle": {"linger": "10m"}})
    shell("request", "arm", "--wait")
    shell("release", "arm")
    wait_for(lambda: why(shell, "arm")[0].endswith("not wanted:"))
    assert why(shell, "arm")[1].startswith("it lingers for ")


@pytest.mark.slow
def test_a_program_that_ends_again_and_again_is_not_said_to_fail_to_start(shell):
    begin(shell, arm={"command": ["sh", "-c", "exit 7"]})
    shell("request", "arm")
    wait_for(lambda: any(line.startswith("it waits: ended with exit code 7; again in ") for line in why(shell, "arm")))
    wait_for(lambda: "rorg restart arm" in shell("retry", "arm", code=5).stderr)
    assert "rorg get" in shell("retry", "base", code=5).stderr, "nothing is wrong with it"


@pytest.mark.slow
def test_a_probe_that_fails_is_named(shell, tmp_path):
    answers = tmp_path / "answers"
    answers.touch()
    probes = {
        "deaf": {"ready": {"file": "/nonexistent"}},
        "picky": {"ready": {"exec": "false"}},
        "hangs": {"live": {"file": str(answers), "interval": "200ms", "failures": 1}},
    }
    begin(shell, **probes)
    for name in probes:
        shell("request", name)
    wait_for(lambda: why(shell, "deaf")[-1] == "it waits: `ready` (file /nonexistent) fails: No such file or directory")
    wait_for(lambda: why(shell, "picky")[-1] == "it waits: `ready` (exec false) fails: exits 1")
    assert not any("`live`" in line for line in why(shell, "hangs"))
    answers.unlink()
    ended = f"it waits: `live` (file {answers}) failed, which ended its last run"
    wait_for(lambda: ended in why(shell, "hangs"))
