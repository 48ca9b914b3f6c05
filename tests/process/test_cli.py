"""The command line: what goes where, and exit codes."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
import yaml
from cli_shell import SERVICES, shell  # noqa: F401
from common import wait_for
from robots import write_tree


@pytest.mark.slow
def test_exit_codes_without_an_engine(shell, tmp_path):  # noqa: F811
    assert shell("validate", str(shell.tree)).stdout == ""
    assert "cannot" in shell("validate", str(tmp_path / "nothing"), code=2).stderr
    assert shell("diff", str(shell.tree), code=1).stdout.startswith("+ ")
    shell("nonsense", code=2)
    shell("diff", str(shell.tree), "--engine", "nonsense", code=2)
    found = shell("diff", str(shell.tree), "--engine", "docker", code=3, DOCKER_HOST="unix:///nowhere.sock")
    assert "cannot" in found.stderr
    assert found.stdout == ""
    assert "--yes" in shell("apply", str(shell.tree), code=5).stderr
    (shell.tree / "services" / "base.yaml").write_text("kind: Service\n- x")
    found = shell("validate", str(shell.tree), "-o", "json", code=2)
    assert json.loads(found.stdout)[0]["line"] == 2
    lines = shell("diff", str(shell.tree), code=2).stderr.splitlines()
    assert lines[-1] == "fix them, then `rorg validate`"


def test_an_internal_error_is_70_and_never_1(shell):  # noqa: F811
    bug = "import sys; from rorg.cli import differences, main; differences.differences = lambda *_: 1 // 0; main.run()"
    found = subprocess.run([sys.executable, "-c", bug, "diff", str(shell.tree)], capture_output=True, text=True)
    assert found.returncode == 70
    assert "internal error: ZeroDivisionError" in found.stderr


def test_a_requests_file_that_is_none_is_told(shell):  # noqa: F811
    shell.state.mkdir()
    (shell.state / "requests.yaml").mkdir()
    assert "not a regular file" in shell("diff", str(shell.tree), code=2).stderr


@pytest.mark.slow
def test_apply_alone_and_again(shell):  # noqa: F811
    shell("apply", str(shell.tree), "--yes", "--wait")
    assert shell("diff", str(shell.tree), code=0).stdout == "No differences.\n"
    rows = yaml.safe_load(shell("get", "services", "-o", "yaml").stdout)
    assert {r["service"]: r["health"] for r in rows if r["state"] != "meta"} == {
        "base": "Healthy",
        "navigation": "Idle",
        "roscore": "Idle",
    }
    assert shell("get", "-o", "name").stdout.split() == ["base", "navigation", "roscore"]
    assert shell("get", "groups").stdout.splitlines() == ["NAME     SERVICES", "driving  navigation"]


def test_apply_that_does_not_get_ready_exits_4(shell):  # noqa: F811
    write_tree(shell.tree, {"base": {"always_on": True, "command": ["false"]}})
    told = shell("apply", str(shell.tree), "--yes", "--wait", code=4).stderr
    assert "base" in told
    assert "rorg: apply incomplete: 1 service not ready" in told


@pytest.mark.slow
def test_request_why_release_with_a_running_loop(shell):  # noqa: F811
    shell.run()
    shell("request", "driving", "--id", "tour", "--reason", "a visitor", "--wait")
    assert {"navigation", "roscore"} <= shell.active()
    lines = shell("why", "roscore").stdout.splitlines()
    assert lines == [
        "roscore is running, and wanted:",
        "  roscore (needed by navigation)",
        "    navigation (requested by developer (tour))",
        "      developer (meta-service)",
    ]
    assert json.loads(shell("get", "requests", "-o", "json").stdout)[0]["reason"] == "a visitor"
    shell("request", "navigation", "--id", "tour", "--wait")
    assert shell("get", "requests").stdout.splitlines()[1].split() == ["tour", "developer", "navigation", "live"]
    shell("release", "tour")
    shell("release", "tour")
    wait_for(lambda: shell.active() == {"base"})
    assert "not wanted" in shell("why", "navigation").stdout
    assert "needed_by: []" in shell("describe", "navigation").stdout
    sources = json.loads(shell("describe", "navigation", "-o", "json").stdout)["sources"]
    explained = shell("explain", "navigation", RORG_STATE_DIR=str(shell.state)).stdout.splitlines()[1:]
    assert sources.items() >= {"priority": "default", "restart": "default"}.items()
    found = [line.split()[0] for line in explained if line.endswith(f" {sources[line.split()[0]]}")]
    assert found == list(sources), "one source for both"
    assert '"navigation" -> "roscore";' in shell("graph", "-o", "dot").stdout
    shell("logs", "navigation")


@pytest.mark.slow
def test_what_a_service_waits_for_reads_as_a_sentence(shell):  # noqa: F811
    gpu = {"exclusive": ["gpu"]}
    write_tree(shell.tree, {"base": {"always_on": True}, "camera": gpu, "tracker": {**gpu, "priority": 90}})
    shell.run()
    for name in ("camera", "tracker"):
        shell("request", name, "--id", name)
    wait_for(lambda: "tracker" in shell.active() and "camera" not in shell.active())
    lines = shell("why", "camera").stdout.splitlines()
    assert lines[0].endswith("preempted:")
    assert lines[1:] == [
        "  camera (requested by developer (camera))",
        "    developer (meta-service)",
        "  request 'camera' of developer names it",
        "  it waits for gpu, which is taken by tracker",
        "  tracker (requested by developer (tracker)) <- developer (meta-service) is active",
        "  to let it in: `rorg release tracker`",
    ]
    (row,) = json.loads(shell("get", "camera", "-o", "json").stdout)
    assert (row["health"], row["why"], row["rivals"]) == ("Preempted", "requested by developer (camera)", ["tracker"])
    assert row["message"] == "waits for gpu, which is taken by tracker"
    shell("hold", "tracker", "--for", "10m", "--yes")
    lines = shell("why", "tracker").stdout.splitlines()
    assert lines[0].endswith(" waiting:")
    assert lines[-2].startswith("  it waits: held until ")
    assert lines[-1] == "  to let it in: `rorg hold tracker --end`"
    shell("hold", "tracker", "--end")
    shell("release", "tracker")
    wait_for(lambda: "camera" in shell.active())


@pytest.mark.slow
def test_only_what_would_let_a_service_in_is_suggested(shell):  # noqa: F811
    gpu = {"exclusive": ["gpu"]}
    specs = {"camera": gpu, "base": {**gpu, "always_on": True, "priority": 90}, "viewer": {"needs": ["camera"]}}
    write_tree(shell.tree, specs)
    shell.run()
    shell("request", "viewer")
    lines = shell("why", "viewer").stdout.splitlines()
    assert lines[0].endswith(" preempted:")
    assert "  it waits: camera waits for gpu, which is taken by base" in lines
    assert "rorg release" not in "".join(lines), "no request keeps the base active"


@pytest.mark.slow
def test_requests_that_cannot_be_accepted(shell):  # noqa: F811
    shell.run()
    assert "'navigation'" in shell("request", "navigaton", code=2).stderr
    assert shell("request", "navigation", "--as", "roscore", code=5).stderr.startswith("rorg: cannot request")
    assert not (shell.state / "requests.yaml").exists()


@pytest.mark.slow
def test_a_driver_is_not_restarted_without_being_asked(shell):  # noqa: F811
    shell.run()
    before = json.loads(shell("get", "services", "base", "-o", "json").stdout)[0]["incarnation"]
    assert "moves hardware" in shell("restart", "base", code=5).stderr
    shell("restart", "base", "--yes", "--wait")
    after = json.loads(shell("get", "services", "base", "-o", "json").stdout)[0]["incarnation"]
    assert before != after


@pytest.mark.slow
def test_apply_of_another_tree_is_refused_while_one_is_followed(shell, tmp_path):  # noqa: F811
    shell.run()
    other = write_tree(tmp_path / "other", {"base": {}})
    assert "owns this robot" in shell("apply", str(other), "--yes", code=5).stderr


@pytest.mark.slow
def test_a_change_is_applied_by_the_running_loop(shell):  # noqa: F811
    shell.run()
    write_tree(shell.tree, {**SERVICES, "camera": {"always_on": True}})
    shell("apply", str(shell.tree), "--yes", "--wait")
    assert "camera" in shell.active()


@pytest.mark.slow
def test_secrets_are_in_no_output(shell):  # noqa: F811
    write_tree(shell.tree, {"base": {"always_on": True, "container": {"environment": {"KEY": "hunter2"}}}})
    shell("apply", str(shell.tree), "--yes", "--wait")
    write_tree(shell.tree, {"base": {"always_on": True, "container": {"environment": {"KEY": "hunter3"}}}})
    outputs = [
        shell("diff", str(shell.tree), code=1),
        shell("diff", str(shell.tree), "-o", "json", code=1),
        shell("describe", "base"),
        shell("apply", str(shell.tree), "--yes", "--wait"),
    ]
    texts = (
        "".join(o.stdout + o.stderr for o in outputs)
        + "".join(path.read_bytes().decode(errors="replace") for path in shell.state.glob("journal.db*"))
        + (shell.state / "status.json").read_text()
    )
    assert "environment.KEY" in texts
    assert "hunter" not in texts


@pytest.mark.parametrize("name", ["bash", "zsh", "fish"])
def test_completion(shell, name):  # noqa: F811
    assert "_RORG_COMPLETE" in shell("completion", name).stdout


@pytest.mark.slow
def test_a_hold_and_a_suspension_are_shown_and_end(shell):  # noqa: F811
    shell.run()
    shell("request", "driving")
    wait_for(lambda: "navigation" in shell.active())
    shell("hold", "driving", "--for", "10m", "--reason", "calibration")
    wait_for(lambda: "navigation" not in shell.active())
    assert "calibration" in shell("get", "services", "driving").stdout
    assert "calibration" in shell("why", "navigation").stdout
    shell("hold", "navigation", code=2)
    shell("hold", "developer", "--for", "1m", code=2)
    shell("suspend", "--for", "10m", "--reason", "maintenance")
    shell("hold", "navigation", "--end")
    assert "suspended until" in wait_for(
        lambda: (d := shell("diff", str(shell.tree), code=1).stdout) and "resume" in d and d
    )
    assert "navigation" not in shell.active()
    shell("suspend", "--end")
    wait_for(lambda: "navigation" in shell.active())


def test_a_request_with_a_lease_says_so(shell):  # noqa: F811
    shell.run()
    shell("request", "navigation", "--ttl", "10s", "--priority", "80", "--reason", "tour")
    why = shell("why", "navigation").stdout
    assert "request 'navigation' of developer names it, priority 80, lease of 10 s, because tour" in why
    shell("request", "navigation", "--ttl", "soon", code=2)


def test_a_request_over_the_budget_is_refused_where_the_policy_says_so(shell):  # noqa: F811
    write_tree(
        shell.tree,
        {**SERVICES, "aa": {"resources": {"cpu": 0.6}}, "bb": {"resources": {"cpu": 0.6}}},
        policies={"policy": {"budget": {"cpu": 1.0, "over": "refuse"}}},
    )
    shell.run()
    shell("request", "aa")
    assert "1.2 cores would exceed the budget of 1" in shell("request", "bb", code=5).stderr
    shell("request", "aa", "--id", "again")


@pytest.mark.slow
def test_wait_events_and_top_talk_to_the_running_rorg(shell):  # noqa: F811
    shell("wait", "navigation", code=3)
    shell.run()
    shell("request", "navigation")
    assert "navigation ready" in shell("wait", "navigation").stdout
    assert "start navigation" in shell("events", "--tail", "30").stdout
    lines = [json.loads(line) for line in shell("events", "-o", "json").stdout.splitlines()]
    assert any(e["kind"] == "request" and e["author"] for e in lines)
    assert "navigation" in shell("top", "--once").stdout
    found = json.loads(shell("top", "-o", "json").stdout)
    assert {r["service"] for r in found["services"]} == {"roscore", "navigation", "base"}
    assert found["machine"]["cores"] >= 1
    shell("hold", "navigation", "--for", "5m")
    assert "held until" in shell("wait", "navigation", code=4).stderr


@pytest.mark.slow
def test_a_wait_that_fails_says_the_reason_of_what_was_asked_for(shell):  # noqa: F811
    shell.run()
    shell("hold", "navigation", "--for", "10m", "--reason", "calibration")
    assert "navigation: held until" in shell("request", "navigation", "--wait", "--timeout", "2", code=4).stderr
    shell("hold", "navigation", "--end")
    shell("release", "navigation")
    wait_for(lambda: "navigation" not in shell.active())
    assert "nothing active requests it" in shell("wait", "navigation", "--timeout", "1", code=4).stderr
    shell("suspend", "--for", "10m", "--reason", "maintenance")
    assert "maintenance" in shell("request", "navigation", "--wait", "--timeout", "2", code=4).stderr
    assert "maintenance" in shell("get").stderr


def test_with_a_mistake_in_the_tree_the_running_robot_can_still_be_looked_at(shell):  # noqa: F811
    shell.run()
    shell("request", "navigation", "--wait")
    (shell.tree / "services/bad.yaml").write_text("x: [\n")
    wait_for(lambda: "manifests refused" in shell("get").stderr)
    assert "requested by developer" in shell("why", "navigation").stdout
    shell("logs", "navigation")
    assert "driving" not in shell("why", "driving").stdout
    shell("restart", "navigation", "--wait")


def test_what_is_not_there_is_told_by_name(shell):  # noqa: F811
    shell.run()
    for kind in ("request", "group", "image", "service"):
        assert "nope" in shell("get", kind, "nope", code=2).stderr
    assert "an id begins with" in shell("request", "roscore", "--id", "a b/c", code=2).stderr
    assert "lease of 0 s" in shell("request", "roscore", "--ttl", "0s", code=2).stderr
    assert "it is not wanted" in shell("restart", "navigation", code=5).stderr
    assert "meta-service" in shell("restart", "developer", code=2).stderr


@pytest.mark.slow
def test_a_name_in_the_requests_file_that_means_nothing_is_told(shell):  # noqa: F811
    shell.run()
    shell("request", "roscore", "--id", "work")
    wait_for(lambda: "roscore" in shell.active())
    path = shell.state / "requests.yaml"
    path.write_text(path.read_text().replace("services: [roscore]", "services: [roscroe]"))
    wait_for(lambda: "names 'roscroe', which is not declared" in shell("events").stdout)
    assert "'roscore'" in shell("events").stdout
