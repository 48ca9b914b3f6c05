"""What `rorg diff` and `rorg apply` show: old and new values of what is changed, and never what may be secret."""

from __future__ import annotations

import json

import pytest
from repositories import Repository
from robots import RealRobot, write_tree
from thin_commands import rorg

from rorg.core.changed_fields import Change
from rorg.core.masking import masked

SECRET = "hunter2-and-more"


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """A loop with its API, in this process."""
    monkeypatch.chdir(tmp_path)
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(services("slow", "60"))
    found.wait(lambda: "base" in found.active())
    found.settle()
    yield found
    found.close()


def services(secret: str, seconds: str) -> dict:
    command = ["sh", "-c", f"exec sleep {seconds}", "--password", secret]
    return {"base": {"always_on": True, "command": command, "container": {"environment": {"MAP": secret}}}, "spare": {}}


# -- masking ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "value", "shown"),
    [
        ("environment.MAP", "lab", "***"),
        ("environment", {"MAP": "lab"}, "***"),
        ("environment.PYTHONUNBUFFERED", "1", "1"),
        ("environment.USE_SIM_TIME", "True", "True"),
        ("environment.EMPTY", "", ""),
        ("environment.PIN", "42", "***"),
        ("environment.API_TOKEN", "1", "***"),
        ("environment.PASSWORD", "", "***"),
        ("labels", {"map": "lab", "api_key": "x"}, {"map": "lab", "api_key": "***"}),
        ("command", "run --password=x --speed 2", "run --password=*** --speed 2"),
        ("command", "run --api-key 'x y' --speed 2", "run --api-key *** --speed 2"),
        ("command", "roslaunch a.launch token:=x speed:=2", "roslaunch a.launch token:=*** speed:=2"),
        ("command", ["run", "--secret", "x", "--speed", "2"], ["run", "--secret", "***", "--speed", "2"]),
        ("command", "curl https://me:x@host/path", "curl https://me:***@host/path"),
        ("command", "curl -H 'Authorization: Bearer x'", "curl -H 'Authorization: Bearer ***"),
        ("command", "DB_PASSWORD=x run", "DB_PASSWORD=*** run"),
        ("command", "mysql -h db -pX9 maps", "mysql -h db -p*** maps"),
        (
            "command",
            ["sh", "-c", "/usr/bin/mysqldump -p 'a b' maps | ssh -p 22 base"],
            ["sh", "-c", "/usr/bin/mysqldump -p *** maps | ssh -p 22 base"],
        ),
        (
            "command",
            ["/usr/bin/sshpass", "-p", "x", "scp", "-P", "22"],
            ["/usr/bin/sshpass", "-p", "***", "scp", "-P", "22"],
        ),
        ("command", ["curl", "-ume:x", "-X", "PUT"], ["curl", "-u***", "-X", "PUT"]),
        ("command", "redis-cli -a x ping", "redis-cli -a *** ping"),
        ("command", ["ssh", "-p", "22"], ["ssh", "-p", "22"]),
        ("command", "ssh -p 22 base mysql -h db", "ssh -p 22 base mysql -h db"),
        ("healthcheck", {"test": ["CMD", "ask", "--token", "x"]}, {"test": ["CMD", "ask", "--token", "***"]}),
        ("volumes", ["/etc/secrets:/run/secrets:ro"], ["/etc/secrets:/run/secrets:ro"]),
        ("command", "sleep 60", "sleep 60"),
        ("cpus", 2.0, 2.0),
        ("cpus", None, None),
    ],
)
def test_what_may_be_secret_is_masked(field, value, shown):
    assert masked(field, value) == shown


@pytest.mark.parametrize(
    ("field", "old", "new", "text"),
    [
        ("image", "a:1", "a:2", "image: a:1 -> a:2"),
        ("cpus", None, 2.0, "cpus: (unset) -> 2.0"),
        ("mem_limit", 512 << 20, 1 << 30, "mem_limit: 512Mi -> 1.0Gi"),
        ("privileged", False, True, "privileged: false -> true"),
        ("command", ["sh", "-c", "a b"], ["sh", "-c", "a c"], "command: sh -c 'a b' -> sh -c 'a c'"),
        ("volumes", ["/a:/a", "/b:/b"], ["/b:/b", "/c:/c"], "volumes: + /c:/c, - /a:/a"),
        ("dns", ["1.1.1.1", "8.8.8.8"], ["8.8.8.8", "1.1.1.1"], "dns: order changed"),
        ("environment.MAP", "***", "***", "environment.MAP changed"),
        ("environment.MAP", None, "***", "environment.MAP added"),
        ("environment.MAP", "***", None, "environment.MAP removed"),
        ("command", "run --token ***", "run --token ***", "command changed"),
    ],
)
def test_a_change_is_told_in_one_line(field, old, new, text):
    assert str(Change(field, old, new)) == text


def test_a_long_value_is_cut_to_what_differs():
    text = str(Change("command", "x" * 200 + " one " + "y" * 200, "x" * 200 + " two " + "y" * 200))
    assert " one " in text
    assert " two " in text
    assert len(text) < 160


# -- commands --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_diff_shows_one_line_a_service_and_the_steps_on_demand(robot):
    rorg(robot, "suspend", "--for", "10m")
    write_tree(robot.tree, services("slow", "61"))
    line, *rest = rorg(robot, "diff", code=1).stdout.splitlines()
    assert line.startswith("-/+ replace base ")
    assert "exec sleep 60" in line.partition(" -> ")[0]
    assert "exec sleep 61" in line.partition(" -> ")[2]
    assert len(rest) == 2, rest  # that rorg is suspended, and the counts
    steps = rorg(robot, "diff", "-o", "wide", code=1).stdout
    for verb in ("create", "rename", "stop", "start"):
        assert f" {verb} " in steps
        assert f" {verb} " not in line
    assert "changed: command" in steps


@pytest.mark.slow
@pytest.mark.parametrize("running", [True, False], ids=["running", "alone"])
def test_no_form_of_a_diff_tells_a_secret(robot, running):
    rorg(robot, "suspend", "--for", "10m")
    write_tree(robot.tree, services(SECRET, "60"))
    if not running:
        robot.stop()
    forms = [rorg(robot, "diff", *words, code=1) for words in ((), ("-o", "wide"), ("-u",), ("-u", "-o", "json"))]
    for done in forms:
        assert SECRET not in done.stdout + done.stderr
        assert "hunter" not in done.stdout
    assert "environment.MAP changed" in forms[0].stdout
    assert "command changed" in forms[0].stdout
    unified = forms[2].stdout.splitlines()
    assert unified[0].startswith("--- base (container ")
    assert {"-  # before", "+  # after"} <= set(unified)
    found = json.loads(forms[3].stdout)
    assert {"actions", "waitings", "summary", "services", "unified"} <= set(found)
    changes = next(s for s in found["services"] if s["service"] == "base")["changes"]
    assert [c["new"] for c in changes if c["field"] == "environment.MAP"] == ["***"]


def test_the_unified_form_shows_old_and_new_and_only_what_changes(robot):
    rorg(robot, "suspend", "--for", "10m")
    write_tree(robot.tree, {**services("slow", "61"), "more": {"always_on": True}})
    found = rorg(robot, "diff", "--unified", code=1).stdout
    assert '-  - "exec sleep 60"' in found
    assert '+  - "exec sleep 61"' in found
    assert "+++ more (manifests)" in found
    assert "spare" not in found
    only = rorg(robot, "diff", "-u", "--service", "more", code=1).stdout
    assert [line for line in only.splitlines() if line.startswith("+++")] == ["+++ more (manifests)"]
    assert rorg(robot, "diff", "--service", "spare").stdout == "No differences of spare.\n"


@pytest.mark.slow
def test_a_change_of_probes_alone_is_a_difference_until_it_is_in_force(robot):
    was = services("slow", "60")
    shown = "~   probe   base  live.exec: (unset) -> true; probes only, no restart\nPlan: 1 to probe differently.\n"
    robot.stop()
    write_tree(robot.tree, {**was, "base": {**was["base"], "live": {"exec": "true"}}})
    assert rorg(robot, "diff", code=1).stdout == shown
    assert shown in rorg(robot, "apply", str(robot.tree), "--yes").stderr
    assert rorg(robot, "diff").stdout == "No differences.\n"


@pytest.mark.slow
def test_the_running_rorg_shows_a_change_of_probes_while_it_is_on_trial(robot):
    robot.wait(lambda: robot.status()["tree"]["standing"]["code"] == "good")
    was, ends = services("slow", "60"), {"exec": "false", "timeout": "3s"}
    write_tree(robot.tree, {**was, "base": {**was["base"], "ready": ends}})
    line = "base  ready.exec: (unset) -> false; "
    assert rorg(robot, "diff", code=1).stdout.splitlines()[0] == f"~   probe   {line}probes only, no restart"
    robot.wait(lambda: robot.loop.running.memory.of("base").update.failed)
    why = "not ready within 3 s: exec false exits 1"
    failed = f".   wait    {line}its change failed ({why}), so the previous probes stay"
    assert rorg(robot, "diff", code=1).stdout.splitlines() == [failed, "Plan: 1 with the previous probes."]
    assert (
        f"  caution: its change failed: {why}; change it again, or `rorg retry base`\n"
        in rorg(robot, "why", "base").stdout
    )
    robot.wait(lambda: any("the change of base failed" in line for line in robot.lines))
    told = next(line for line in robot.lines if "the change of base failed" in line)
    assert told.endswith("; change it again, or `rorg retry base`"), "its container did not change"
    assert "it stays as it was" in rorg(robot, "apply", str(robot.tree), "--yes", "--wait", code=4).stderr


@pytest.mark.slow
def test_the_running_rorg_shows_the_probes_of_an_earlier_state(robot):
    repository = Repository(robot.tree)
    first = repository.commit("First")
    was = services("slow", "60")
    write_tree(robot.tree, {**was, "base": {**was["base"], "live": {"exec": "true"}}})
    repository.commit("Second")
    assert "live.exec: true -> (unset); probes only" in rorg(robot, "diff", first, code=1).stdout


@pytest.mark.slow
@pytest.mark.parametrize("running", [True, False], ids=["running", "alone"])
def test_apply_says_that_an_idle_service_is_not_tried(robot, running):
    """Waiting for it would never end, and nothing has failed."""
    if not running:
        robot.stop()
    write_tree(robot.tree, {**services("slow", "60"), "spare": {"command": ["sleep", "61"]}})
    said = rorg(robot, "apply", str(robot.tree), "--yes", "--wait=proven").stderr.splitlines()
    told = "applied, but not run since the change: spare; rorg tries an idle service when something requests it"
    assert told in said
    assert "not run" not in rorg(robot, "apply", str(robot.tree), "--yes", "--wait").stderr


@pytest.mark.slow
def test_apply_refuses_at_once_while_rorg_is_suspended(robot):
    rorg(robot, "suspend", "--for", "10m", "--reason", "maintenance")
    write_tree(robot.tree, services("slow", "61"))
    for running in (True, False):
        if not running:
            robot.stop()
        said = rorg(robot, "apply", str(robot.tree), "--yes", code=5).stderr
        assert "exec sleep 61" in said
        assert "maintenance" in said
        assert "rorg suspend --end" in said


@pytest.mark.slow
def test_another_tree_than_the_one_in_force_is_told(robot, tmp_path):
    other = write_tree(tmp_path / "other", {"camera": {}})
    assert f"follows {robot.tree}" in rorg(robot, "diff", str(other), code=1).stderr
    refused = rorg(robot, "apply", str(other), "--yes", code=5).stderr
    assert f"follows {robot.tree}" in refused
    assert "camera" not in refused  # it is refused before anything is shown
    assert rorg(robot, "diff").stderr == ""
    robot.stop()
    assert f"rorg followed {robot.tree}" in rorg(robot, "diff", str(other), code=1).stderr


def test_a_tree_that_lies_here_and_is_not_followed_is_told(robot, tmp_path, monkeypatch):
    write_tree(tmp_path / "mine/manifests", {"camera": {}})
    monkeypatch.chdir(tmp_path / "mine")
    said = rorg(robot, "diff").stderr
    assert f"follows {robot.tree}" in said
    assert str(tmp_path / "mine/manifests") in said
