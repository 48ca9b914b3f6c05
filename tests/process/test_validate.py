"""`rorg validate` and what it prints of findings, in each form."""

from __future__ import annotations

import json

import pytest
from commands import rorg
from finding_cases import build
from robots import RealRobot

from rorg.errors import advice


@pytest.mark.slow
def test_hints_are_shown_on_request(tmp_path):
    tree = build(tmp_path, {"net": "image: net:1\ncontainer: {tty: true}\n"})
    assert rorg("validate", ".", cwd=tree).stderr == "ok: 1 service\n"
    assert json.loads(rorg("validate", ".", "-o", "json", cwd=tree).stdout) == []
    assert "services/net.yaml:6:20: hint: 'net' has a terminal" in rorg("validate", ".", "--hints", cwd=tree).stderr
    (run,) = json.loads(rorg("validate", ".", "--hints", "-o", "sarif", cwd=tree).stdout)["runs"]
    assert run["results"][0]["level"] == run["tool"]["driver"]["rules"][0]["defaultConfiguration"]["level"] == "note"


@pytest.mark.slow
def test_json_and_sarif_tell_code_place_and_remedy(tmp_path):
    tree = build(
        tmp_path, {"arm": "image: arm:1\ncontainer: {privileged: true}\n", "base": "image: base:1\nimage: b:1\n"}
    )
    (error,) = json.loads(rorg("validate", ".", "-o", "json", code=2, cwd=tree).stdout)
    assert (error["code"], error["line"], error["column"]) == ("duplicate-key", 6, 3)
    (tree / "services/base.yaml").unlink()
    (found,) = json.loads(rorg("validate", ".", "-o", "json", cwd=tree).stdout)
    (run,) = json.loads(rorg("validate", ".", "-o", "sarif", cwd=tree).stdout)["runs"]
    (rule,), (result,) = run["tool"]["driver"]["rules"], run["results"]
    assert (found["code"], rule["id"], result["ruleId"], result["ruleIndex"]) == (*["privileged"] * 3, 0)
    (place,) = result["locations"]
    region = place["physicalLocation"]["region"]
    assert (region["startLine"], region["startColumn"]) == (found["line"], found["column"]) == (6, 27)
    assert place["physicalLocation"]["artifactLocation"]["uri"] == found["file"] == "services/arm.yaml"
    assert result["level"] == rule["defaultConfiguration"]["level"] == found["severity"] == "warning"
    assert result["message"]["text"] == f"{found['message']}{advice(found['remedy'])}"


@pytest.mark.slow
def test_diff_tells_warnings_with_and_without_a_running_rorg(tmp_path):
    """On standard error: what is to be done alone is data."""
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    environment = {"RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "process"}
    try:
        robot.declare({"arm": {"command": "sleep 60 && true"}})
        robot.settle()
        told = rorg("diff", **environment)
        assert "[shell-words-without-shell]" in told.stderr
        assert "[" not in told.stdout
        warnings = robot.client().call("GET", "/v1/status")["tree"]["warnings"]
        assert [w["code"] for w in warnings] == ["shell-words-without-shell"]
    finally:
        robot.close()
    assert "[shell-words-without-shell]" in rorg("diff", str(robot.tree), code=1, **environment).stderr


def test_validate_looks_at_this_machine_where_it_is_asked_to(tmp_path):
    tree = build(tmp_path, {"laser": "image: laser:1\ndriver: {devices: [/dev/no-such-laser]}\n"})
    nobody = f"unix://{tmp_path}/nobody.sock"
    plain = rorg("validate", str(tree), "-o", "json")
    assert json.loads(plain.stdout) == []
    told = rorg("validate", str(tree), "--machine", "-o", "json", DOCKER_HOST=nobody)
    assert [(d["code"], d["line"]) for d in json.loads(told.stdout)] == [("missing-device", 6)]
    assert "does not answer, and is not checked" in told.stderr
