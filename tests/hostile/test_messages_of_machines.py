"""Whatever a message of another machine says within its types and bounds, the pass that takes it up ends well."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from common import wait_for
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter
from robots import RealRobot

from rorg.api.machine_routes import ANSWER, REPORT, Received
from rorg.core.links import Link
from rorg.daemon.machines import Machines

SLEEP = {"image": "host", "command": "sleep infinity"}
SERVICES = {
    "tour": {**SLEEP, "machine": "base", "needs": [{"service": "camera", "restart": True}], "may_request": ["map"]},
    "map": {**SLEEP, "machine": "base", "exclusive": ["gpu"]},
    "camera": {**SLEEP, "machine": "bad", "always_on": True},
    "bridge": {**SLEEP, "machine": "bad", "needs": ["map"], "may_request": ["map", "tour"]},
}
RENEWAL = TypeAdapter(Received)
MACHINES = {"base": {"address": "127.0.0.1:1", "lease": 10}, "bad": {"address": "127.0.0.1:2", "lease": 10}}

names = st.sampled_from([*SERVICES, "developer", "nosuch", "", "../x", "\x1b[31m\n", "a" * 5000])
texts = (
    names
    | st.text(max_size=20)
    | st.sampled_from(["running", "none", "paused", "exited", "Healthy", "x@y", "@", "x@2026"])
)
numbers = st.integers(-(2**63) + 1, 2**63 - 1) | st.integers(-2, 5)
reals = st.floats(allow_nan=False, allow_infinity=False)
stamps = st.tuples(numbers, numbers)
remotes = st.fixed_dictionaries(
    {"state": texts, "wanted": st.booleans(), "ready": st.booleans(), "health": texts, "sync": texts},
    optional={"incarnation": texts, "reason": texts},
)
reports = st.fixed_dictionaries(
    {
        "incarnation": st.just(7) | numbers,
        "version": numbers,
        "heard": stamps,
        "services": st.dictionaries(st.sampled_from(["camera", "bridge"]) | names, remotes, min_size=1, max_size=4),
    }
)
requests = st.fixed_dictionaries(
    {"id": texts, "requester": names, "services": st.lists(names, max_size=3)},
    optional={
        **{"reason": texts, "incarnation": st.none() | texts, "standing": st.booleans(), "renewed": texts},
        **{"priority": st.none() | numbers, "ttl": st.none() | reals},
    },
)
renewals = st.fixed_dictionaries(
    {"machine": st.just("bad"), "boot": texts, "incarnation": numbers, "number": numbers, "since": numbers},
    optional={
        **{"requests": st.lists(requests, max_size=4), "excluded": st.dictionaries(names, texts, max_size=3)},
        **{"asking": st.lists(st.tuples(names, reals), max_size=3), "takes": st.lists(names, max_size=3)},
    },
).map(lambda said: {**said, "duration": 10.0})
answers = st.fixed_dictionaries(
    {"incarnation": st.just(7) | numbers, "newest": st.none() | stamps, "report": reports | st.none()},
    optional={
        **{"released": st.lists(names, max_size=3), "kept": st.dictionaries(names, texts, max_size=3)},
    },
)


FORMS = ("renewal", "answer", "report")
messages = st.one_of(*(st.tuples(st.just(n), of) for n, of in zip(FORMS, (renewals, answers, reports), strict=True)))


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Iterator[RealRobot]:
    """The loop of `base`; the test carries the messages."""
    found = RealRobot(tmp_path_factory.mktemp("machines"), "process", None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RORG_MACHINE", "base")
        found.declare(SERVICES, machines=MACHINES)
        found.wait(lambda: found.loop.machines.here == "base" and found.loop.observer.snapshot().complete)
    yield found
    found.close()


@pytest.mark.slow
@given(st.lists(messages, max_size=6))
@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_message_ends_a_pass(robot, said):
    loop, machines = robot.loop, robot.loop.machines
    with machines.changed:
        machines.granted, machines.links["bad"] = {}, Link(10.0, own=machines.incarnation)
    for form, message in said:
        take(machines, form, message)
    passes = loop.passes
    loop.wake()
    wait_for(lambda: loop.passes > passes + 1 or loop.wake(), 20, "a pass after the messages")
    assert [line for line in robot.lines if "internal error" in line or "bug:" in line] == []


def take(machines: Machines, form: str, message: dict[str, Any]) -> None:
    """An answer whose `newest` is None confirms the lease, so that what it reports counts."""
    if form == "renewal":
        machines.receive(RENEWAL.validate_json(json.dumps(message)))
    elif form == "report":
        machines.reported("bad", REPORT.validate_json(json.dumps(message)))
    else:
        sent = machines.renewal("bad")
        newest = message["newest"] or sent.stamp
        machines.answered("bad", ANSWER.validate_json(json.dumps({**message, "newest": newest})))
