"""The figures for Prometheus, read back by the library's own parser from the API's socket."""

from __future__ import annotations

import os
import re
import socket
from contextlib import closing
from http.client import HTTPConnection

import pytest
from common import ROOT, wait_for
from prometheus_client.openmetrics.parser import text_string_to_metric_families
from prometheus_client.parser import text_string_to_metric_families as old_format
from robots import RealRobot

TREE = {"camera": {"idle": {"action": "stop"}}, "base": {"always_on": True}}


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(TREE)
    found.wait(lambda: "base" in found.active())
    yield found
    found.close()


class Connection(HTTPConnection):
    """To a unix socket."""

    def __init__(self, path: str) -> None:
        super().__init__("rorg")
        self.path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.connect(self.path)


def get(robot: RealRobot, **headers: str) -> tuple[str, str]:
    """The media type and the text."""
    with closing(Connection(robot.socket())) as connection:
        connection.request("GET", "/metrics", headers=headers)
        answer = connection.getresponse()
        text = answer.read().decode()
        assert answer.status == 200, text
        return answer.headers["content-type"], text


def scrape(robot: RealRobot) -> dict[tuple[str, ...], float]:
    """(name, values of the labels, the service first) of each sample -> its value."""
    samples = [s for family in text_string_to_metric_families(get(robot)[1]) for s in family.samples]
    return {(s.name, *(s.labels[k] for k in sorted(s.labels, key=lambda k: k != "service"))): s.value for s in samples}


def test_services_are_told_with_health_and_use(robot):
    found = scrape(robot)
    assert found["rorg_service_wanted", "base"] == 1
    assert found["rorg_service_wanted", "camera"] == 0
    wait_for(lambda: scrape(robot)["rorg_service_health", "base", "Healthy"] == 1, what="base is healthy")
    found = scrape(robot)
    assert sum(v for k, v in found.items() if k[:2] == ("rorg_service_health", "base")) == 1
    assert found["rorg_service_memory_bytes", "base"] > 100_000
    assert ("rorg_service_memory_bytes", "camera") not in found, "what does not run uses nothing"
    with robot.client().request("camera", wait=20):
        assert scrape(robot)["rorg_service_wanted", "camera"] == 1
        assert scrape(robot)["rorg_requests",] >= 1


def test_crashes_and_events_are_counted(robot):
    before = scrape(robot)
    robot.kill("base")
    wait_for(lambda: scrape(robot)["rorg_service_crashes_total", "base"] == 1, what="the crash is counted")
    after = scrape(robot)
    assert after["rorg_events_total", "crashed"] == before.get(("rorg_events_total", "crashed"), 0) + 1


def test_the_machine_and_rorg_are_told(robot):
    found = scrape(robot)
    assert found["rorg_engine_up",] == 1
    assert found["rorg_manifest_errors",] == 0
    assert found["rorg_machine_cpu_cores",] == os.cpu_count()
    assert 0 <= found["rorg_machine_cpu_pressure_ratio",] <= 1
    assert found["rorg_machine_memory_bytes",] < found["rorg_machine_memory_total_bytes",]
    assert scrape(robot)["rorg_machine_cpu_seconds_total",] >= found["rorg_machine_cpu_seconds_total",]
    robot.declare({**TREE, "camera": {"needs": ["nothing-there"]}})
    wait_for(lambda: scrape(robot)["rorg_manifest_errors",] == 1, what="the mistake is counted")


def test_the_older_format_is_there_for_who_asks(robot):
    assert get(robot)[0].startswith("application/openmetrics-text")
    assert get(robot, accept="text/plain;q=0.5,application/openmetrics-text")[0].startswith("application/openmetrics")
    kind, text = get(robot, accept="text/plain")
    assert kind.startswith("text/plain")
    samples = [s for family in old_format(text) for s in family.samples]
    assert {s.value for s in samples if s.name == "rorg_engine_up"} == {1}
    assert not {t for t in text.splitlines() if t.startswith("# TYPE") and t.split()[3] in ("info", "stateset")}


def test_the_page_names_what_there_is(robot):
    page = (ROOT / "docs/how-to/metrics.md").read_text()
    table = page[page.index("| metric") : page.index("Useful alerts")]
    named = set(re.findall(r"`(rorg_\w+)", table))
    wait_for(lambda: ("rorg_service_memory_bytes", "base") in scrape(robot), what="the use of base is known")
    there = set(re.findall(r"^(rorg_\w+)", get(robot)[1], re.M)) | {"rorg_events_total", "rorg_shed_services"}
    there.add("rorg_machine_up")  # only of a robot of several
    assert named == there - {name for name in there if name.endswith("_created")}
