"""Every answer of the API is as the OpenAPI document says, field by field."""

from __future__ import annotations

import json
from urllib.parse import quote

import pytest
from common import ROOT
from jsonschema import Draft202012Validator
from robots import RealRobot

from rorg.api.status_models import RunView
from rorg.core.memory import Attempt, Progress
from rorg.core.update import Update
from rorg.daemon.snapshot import run_json

DOCUMENT = json.loads((ROOT / "schemas/openapi.json").read_text())
SERVICES = {
    "roscore": {"ready": {"delay": "0s"}},
    "navigation": {"needs": ["roscore"], "may_request": ["mapping"], "command": ["sh", "-c", "seq 12; exec sleep 600"]},
    "mapping": {"ready": {"file": "/nonexistent", "timeout": "1h"}},
    "planner": {"needs": ["mapping"]},
    "base": {"always_on": True, "restart": "never"},
}


def strict(schema):
    """The same, with no fields but those that are named."""
    if isinstance(schema, dict):
        more = {"additionalProperties": False} if "properties" in schema else {}
        return {k: strict(v) for k, v in schema.items()} | more
    return [strict(s) for s in schema] if isinstance(schema, list) else schema


STRICT = strict(DOCUMENT)
GETS = sorted(path for path, methods in DOCUMENT["paths"].items() if "get" in methods)
NAMES = {"name": "navigation", "kind": "Service", "port": "1", "service": "navigation", "rev": "1", "a": "1", "b": "2"}
QUERIES = {"/v1/connections/{port}": "?to=1", "/v1/wait": "?services=roscore", "/v1/events": "?tail=10000"}
MISSING = {"/v1/listeners/{port}": 404, "/v1/connections/{port}": 404, "/v1/machines/{name}/report": 403}
"""What there is none of here is answered as a problem."""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    found = RealRobot(tmp_path_factory.mktemp("robot"), "process", None, with_server=True)
    found.declare(
        SERVICES,
        groups={"driving": {"services": ["navigation"]}},
        requests={"always": {"requester": "base", "services": ["roscore"]}},
    )
    found.wait(lambda: found.active() >= {"base", "roscore"})
    client = found.client()
    for services, more in ((["driving"], {"ttl": "1h"}), (["planner"], {"priority": 60, "reason": "a visitor"})):
        client.call("PUT", f"/v1/requests/{services[0]}", {"services": services, **more})
    found.wait(lambda: found.active() >= {"navigation", "mapping"} and found.waits("planner"))
    client.hold("base", 3600, "maintenance")
    found.kill("navigation")
    found.wait(lambda: found.loop.recorder.journal.last and any("unexpected exit" in line for line in found.log()))
    (found.tree / "services" / "broken.yaml").write_text("kind: Service\n")
    found.wait(lambda: client.status()["tree"]["errors"])
    yield found
    found.close()


def schema_of(operation, status: int, kind: str):
    return operation["responses"][str(status)]["content"][kind].get("schema")


def hold_to(schema, value) -> None:
    found = [
        f"{'.'.join(map(str, e.absolute_path))}: {e.message[:300]}"
        for e in Draft202012Validator({**schema, "components": STRICT["components"]}).iter_errors(value)
    ]
    assert not found


@pytest.mark.parametrize("path", GETS)
def test_an_answer_has_the_fields_that_are_documented_and_no_others(robot, path):
    from rorg_client.connection import Connection
    from rorg_client.wire import asking, reading

    address = path.format(**{k: quote(v) for k, v in NAMES.items()}) + QUERIES.get(path, "")
    connection = Connection(robot.client().address, 10.0)
    connection.send(asking("GET", address, None, {}), 10.0)
    answer = connection.drive(reading())
    connection.close()
    kind, operation = answer.headers["content-type"].partition(";")[0], STRICT["paths"][path]["get"]
    assert answer.status == MISSING.get(path, 200), answer.body
    if kind == "application/problem+json":
        hold_to(schema_of(operation, answer.status, "application/json"), json.loads(answer.body))
    elif kind == "application/json":
        hold_to(schema_of(operation, 200, kind), json.loads(answer.body))
    elif kind == "application/x-ndjson":
        lines = answer.body.splitlines()
        assert len(lines) > 10
        for line in lines:
            hold_to(schema_of(operation, 200, kind), json.loads(line))
    elif kind == "application/openmetrics-text":  # test_metrics.py reads it
        assert answer.body.endswith(b"# EOF\n")
    else:
        assert kind == "application/yaml"
        assert answer.body.startswith(b"apiVersion")


@pytest.mark.parametrize("operation", ["request", "release", "restart", "hold", "unhold", "suspend", "unsuspend"])
def test_a_preview_has_the_fields_that_are_documented(robot, operation):
    named = [] if operation in ("release", "suspend", "unsuspend") else ["roscore"]
    answer = robot.client().call("POST", "/v1/preview", {"operation": operation, "services": named, "id": "planner"})
    hold_to(schema_of(STRICT["paths"]["/v1/preview"]["post"], 200, "application/json"), answer)


def test_all_that_is_kept_of_a_run_is_documented():
    every = {"edition": "e", "drawn": "d", "held": "h", "proven": "p", "baked": "b", "run": "r"}
    update = Update(**every, quarantined={"e": "why"}, content={"/a": "b"})
    step = Progress(update=update, attempts={"start": Attempt(at=5.0, error="no")}, stopped=("1@t", "2@t"))
    told = run_json(step, 0.0)
    assert set(told) == set(RunView.model_fields)


def test_no_answer_is_only_said_to_be_an_object(robot):
    """What has no fields of its own in the document is no answer that anybody can rely on."""
    schemas = [
        content.get("schema", {})
        for methods in DOCUMENT["paths"].values()
        for operation in methods.values()
        for content in operation["responses"].get("200", {}).get("content", {}).values()
    ]
    loose = [s for s in schemas if (s.get("items", s)).get("additionalProperties") is True]
    assert not loose
    for name, schema in DOCUMENT["components"]["schemas"].items():
        if name not in ("HTTPValidationError", "ValidationError"):
            assert schema.get("properties"), name


def test_what_is_refused_is_told_as_documented(robot):
    from rorg_client import NotReady

    problem = {"schema": schema_of(STRICT["paths"]["/v1/wait"]["get"], 504, "application/json")}["schema"]
    with pytest.raises(NotReady) as told:
        robot.client().wait("planner", timeout=0.0)
    error = told.value
    value = {"type": "urn:rorg:not-ready", "title": error.what, "status": error.status, "code": error.code}
    hold_to(problem, {**value, "cause": error.cause, "remedy": error.remedy, "services": error.services})
