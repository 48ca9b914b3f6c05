"""By what rorg masks, no service learns a secret of another: its own words come back the same, right or wrong."""

from __future__ import annotations

import json
from typing import Any

import pytest
from robots import WORK, RealRobot

from rorg.client import Error

PIN, WRONG = "pin-482913", "pin-482914"
TELLS = {"exec": ["sh", "-c", f"echo the pin is {PIN}; exit 1"], "timeout": "1s"}
GUESSES = {"exec": ["sh", "-c", f"echo {PIN} {WRONG}; exit 1"], "timeout": "1s"}
ALPHA = {"always_on": True, "may_request": ["camera"], "may_restart": ["camera"], "may_manage": ["lab-*"]}
TREE = {
    "alpha": {**ALPHA, "ready": GUESSES},
    "camera": {},
    "vault": {
        "always_on": True,
        "secrets": ["PIN"],
        "container": {"environment": {"PIN": PIN}},
        "ready": TELLS,
    },
}


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    found = RealRobot(tmp_path_factory.mktemp("oracle"), "process", None, with_server=True)
    found.declare(TREE)
    found.wait(lambda: {"alpha", "vault"} <= found.active())
    found.wait(lambda: "pin" in message_of(found, "vault") and "pin" in message_of(found, "alpha"))
    yield found
    found.close()


def message_of(robot: RealRobot, service: str) -> str:
    return json.dumps(robot.client("alpha").service(service))


def answer(robot: RealRobot, method: str, path: str, body: Any = None) -> str:
    """What is answered, whatever it is."""
    try:
        found = robot.client("alpha").call(method, path, body)
        return json.dumps(found.json() if hasattr(found, "json") else found, default=str)
    except Error as error:
        return f"{type(error).__name__} {error}"


def manifest(name: str, **spec: Any) -> str:
    return json.dumps(
        {
            "apiVersion": "rorg/v1",
            "kind": "Service",
            "metadata": {"name": name},
            "spec": {"image": "x", "command": WORK, **spec},
        }
    )


PUT = "/v1/manifests/Service/lab-x"
CALLS = {
    "service": ("GET", "/v1/services/{}", None),
    "why": ("GET", "/v1/services/{}/why", None),
    "wait": ("GET", "/v1/wait?services={}&timeout=0", None),
    "unknown": ("PUT", "/v1/requests/x", {"services": ["{}"]}),
    "forbidden": ("PUT", "/v1/requests/x", {"services": ["vault", "{}"]}),
    "requester": ("PUT", "/v1/requests/x?requester={}", {"services": ["camera"]}),
    "lease": ("PUT", "/v1/requests/x", {"services": ["camera"], "ttl": "{}"}),
    "field": ("PUT", "/v1/requests/x", {"services": ["camera"], "{}": 1}),
    "restart": ("POST", "/v1/services/{}/restart", None),
    "event": ("GET", "/v1/events?since={}", None),
    "route": ("GET", "/v1/{}", None),
    "manifest": ("GET", "/v1/manifests/Service/{}", None),
    "kind": ("GET", "/v1/manifests/{}/x", None),
    "variable": ("PUT", PUT, {"text": manifest("lab-x", profile="{}")}),
    "needs": ("PUT", PUT, {"text": manifest("lab-x", needs=["{}"])}),
    "key": ("PUT", PUT, {"text": manifest("lab-x", **{"{}": 1})}),
    "number": ("PUT", PUT, {"text": manifest("lab-x", priority="{}")}),
    "option": ("PUT", PUT, {"text": manifest("lab-x", container={"{}": "x"})}),
    "base": ("PUT", PUT, {"text": manifest("lab-x"), "base": "{}"}),
    "yaml": ("PUT", PUT, {"text": "{}: ["}),
}


def with_guess(value: Any, guess: str) -> Any:
    return json.loads(json.dumps(value).replace("{}", guess))


@pytest.mark.parametrize("call", CALLS)
def test_an_error_does_not_say_whether_a_guess_is_right(robot, call):
    method, path, body = CALLS[call]
    said = [answer(robot, method, with_guess(path, g), with_guess(body, g)) for g in (PIN, WRONG)]
    assert said[0] == said[1]
    assert said[0].startswith(("NotFound", "Forbidden", "Invalid", "Refused"))
    assert PIN not in said[0]


def test_fields_of_a_call_are_not_masked_in_the_error_that_answers_it(robot):
    robot.client().call("PUT", "/v1/holds/camera", {"duration": "10m", "force": True})
    body = {"services": ["camera"], "reason": "to look", "ttl": "10s"}
    said = answer(robot, "PUT", "/v1/requests/w?wait=10", body)
    robot.client().call("DELETE", "/v1/holds/camera")
    answer(robot, "DELETE", "/v1/requests/w")
    assert said.startswith("NotReady")
    assert said.endswith("try `rorg why` for the reasons")


def test_what_a_service_reads_of_others_stays_masked(robot):
    assert "the pin is ***" in message_of(robot, "vault")
    for path in (f"/v1/services/vault?x={PIN}", f"/v1/wait?services=vault&timeout=0&x={PIN}"):
        said = answer(robot, "GET", path)
        assert PIN not in said
        assert "***" in said


def test_what_a_service_prints_comes_back_as_it_is(robot):
    said = message_of(robot, "alpha")
    assert said.count(PIN) == said.count(WRONG) > 0


def test_ids_and_reasons_of_requests_come_back_as_they_are(robot):
    for guess in (PIN, WRONG):
        body = {"services": ["camera"], "reason": f"because of {guess}"}
        assert guess in answer(robot, "PUT", f"/v1/requests/{guess}", body)
    robot.wait(lambda: "camera" in robot.active())
    said = [answer(robot, "GET", path) for path in ("/v1/requests", "/v1/services/camera/why", "/v1/services/camera")]
    said.append(json.dumps([*robot.client("alpha").events(tail=1000)]))
    assert all("***" not in one for one in said)
    assert PIN in said[0]
    assert PIN in said[-1]
    listed = {r["id"]: r["reason"] for r in robot.client("alpha").requests()}
    assert listed == {guess: f"because of {guess}" for guess in (PIN, WRONG)}
    events = [e for e in robot.client("alpha").events(tail=1000) if e["kind"] == "request"]
    assert {PIN, WRONG} <= {e["request"] for e in events}
    for guess in (PIN, WRONG):
        answer(robot, "DELETE", f"/v1/requests/{guess}")


def test_a_manifest_comes_back_as_it_was_written_and_unmasks_nothing(robot):
    for guess in (PIN, WRONG):
        name = f"lab-{guess}"
        text = manifest(name, container={"environment": {"X": guess}})
        robot.client("alpha").put_manifest("Service", name, text, None)
        robot.settle()
        assert robot.client("alpha").manifest("Service", name).count(guess) == 2
        assert name in [s["service"] for s in robot.client("alpha").services()]
        assert name in [m["name"] for m in robot.client("alpha").manifests()]
        assert "the pin is ***" in message_of(robot, "vault")
        assert f"lab-{guess}" in message_of(robot, name)


def test_people_still_see_no_secret(robot):
    client = robot.client()
    client.request("camera", id="mine", reason=f"because of {PIN}")
    assert PIN not in str([r["reason"] for r in client.requests()])
    assert PIN not in str(client.service("vault"))
    client.release("mine")
