"""A machine under pressure: measures one after another, mildest first, undone when it is over."""

from __future__ import annotations

import time

import pytest
from common import wait_for
from pressed_robots import BURN, GIB, POLICY, service
from robots import RealRobot, VirtualRobot

from rorg.core.pressure import PATIENCE


@pytest.fixture
def robot(tmp_path):
    return VirtualRobot(tmp_path)


def events(robot) -> list[tuple[float, str]]:
    return [(at, text) for at, text in robot.sim.log if not text.startswith(("+", "dropped"))]


def test_the_lowest_priority_gives_way_and_comes_back(robot):
    robot.declare(
        {
            "drive": service(0.5, "1Gi", 90, protected=True),
            "map": service(0.6, "1Gi", 70),
            "log": service(0.5, "1Gi", 20),
        },
        policies=POLICY,
    )
    robot.request("drive", "map", "log")
    robot.wait(lambda: robot.active() == {"drive", "map", "log"})
    robot.sim.extra = (0.9, 0)
    began = robot.now()
    robot.wait(lambda: robot.active() == {"drive", "map"})
    assert robot.now() - began < 10
    assert "shed under pressure: 2.5 of 2.0 cores in use" in robot.waits("log")
    robot.sim.extra = (0.0, 0)
    robot.wait(lambda: robot.active() == {"drive", "map", "log"})
    robot.wait(lambda: robot.sim.memory.pressure.level == 0)
    assert not any(
        "drive" in text or "map" in text
        for at, text in events(robot)
        if at > began
        and "cpu" not in text
        and "update" not in text
        and "leaves the CPU" not in text
        and "pressure is over" not in text
    )


@pytest.mark.parametrize(("extra", "shed"), [((1.6, 0), "thinks"), ((0.0, 3 * GIB), "remembers")])
def test_among_equals_the_largest_user_of_what_is_short_is_shed(robot, extra, shed):
    """Either one would help: `thinks` frees enough memory, and `remembers` enough CPU. The larger user frees more."""
    services = {"thinks": service(0.6, "256Mi", 20), "remembers": service(0.1, "1Gi", 20)}
    robot.declare(services, policies=POLICY)
    robot.request(*services)
    robot.wait(lambda: robot.active() == {*services})
    robot.sim.extra = extra
    robot.wait(lambda: robot.sim.memory.pressure.shed)
    assert [s.service for s in robot.sim.memory.pressure.shed] == [shed]


def test_shares_are_lowered_first_and_put_back(robot):
    robot.declare(
        {
            "drive": service(0.5, "1Gi", 90, protected=True),
            "map": service(0.6, "1Gi", 70),
            "log": service(0.5, "1Gi", 20, container={"cpu_shares": 512}),
        },
        policies=POLICY,
    )
    robot.request("drive", "map", "log")
    robot.wait(lambda: len(robot.active()) == 3)
    robot.sim.extra = (0.6, 0)
    robot.wait(lambda: robot.container("log").live.get("cpu_shares") == 103)
    assert len(robot.active()) == 3, "the mildest measure comes first"
    robot.sim.extra = (0.0, 0)
    robot.wait(lambda: robot.container("log").live.get("cpu_shares") == 512)
    robot.wait(lambda: robot.container("map").live.get("cpu_shares") == 1024)
    assert "cpu_shares" not in robot.container("drive").live


def test_what_lingers_is_ceased_at_once(robot):
    robot.declare(
        {"map": service(0.6, "1Gi", 70), "log": service(0.6, "1Gi", 20, idle={"linger": "10m"})}, policies=POLICY
    )
    robot.request("map", id="map")
    robot.request("log", id="log")
    robot.wait(lambda: len(robot.active()) == 2)
    robot.release("log")
    robot.sim.extra = (1.5, 0)
    robot.wait(lambda: robot.active() == {"map"}, 20)
    assert not robot.sim.memory.pressure.shed


def test_paused_services_are_stopped_for_their_memory(robot):
    robot.declare(
        {"map": service(0.6, "1Gi", 70), "log": service(0.6, "2Gi", 20, idle={"action": "pause"})}, policies=POLICY
    )
    robot.request("map", id="map")
    robot.request("log", id="log")
    robot.wait(lambda: len(robot.active()) == 2)
    robot.release("log")
    robot.wait(lambda: robot.states()["log"] == "paused")
    robot.sim.extra = (0.0, 2 * GIB)
    robot.wait(lambda: robot.states()["log"] == "exited", 20)
    assert robot.active() == {"map"}


def test_nothing_of_low_priority_begins_under_pressure(robot):
    robot.declare({"map": service(0.6, "1Gi", 70, protected=True), "log": service(0.1, "1Mi", 20)}, policies=POLICY)
    robot.request("map", id="map")
    robot.wait(lambda: len(robot.active()) == 1)
    robot.sim.extra = (2.0, 0)
    robot.wait(lambda: robot.sim.memory.pressure.level > 0)
    robot.request("log", id="log")
    robot.wait(lambda: "the machine is under pressure" in robot.waits("log"))
    assert robot.active() == {"map"}
    robot.sim.extra = (0.0, 0)
    robot.wait(lambda: robot.active() == {"map", "log"})


def test_protected_services_and_what_they_need_are_never_touched(robot):
    robot.declare(
        {"roscore": service(0.1, "1Gi", 1), "drive": service(0.5, "1Gi", 1, protected=True, needs=["roscore"])},
        policies=POLICY,
    )
    robot.request("drive")
    robot.wait(lambda: len(robot.active()) == 2)
    robot.sim.extra = (4.0, 8 * GIB)
    began = robot.now()
    robot.wait(lambda: robot.now() > began + 60, 120)
    assert robot.active() == {"roscore", "drive"}


def test_a_service_is_not_shed_when_a_protected_one_would_go_with_it(robot):
    robot.declare(
        {
            "drive": service(0.5, "1Gi", 50, protected=True),
            "tour": service(0.6, "1Gi", 10, needs=["drive"]),
            "log": service(0.6, "1Gi", 40),
        },
        policies=POLICY,
    )
    robot.request("tour", "log")
    robot.wait(lambda: len(robot.active()) == 3)
    robot.sim.extra = (1.0, 0)
    robot.wait(lambda: "log" not in robot.active(), 20)
    began = robot.now()
    robot.sim.extra = (3.0, 0)
    robot.wait(lambda: robot.now() > began + 30)
    assert robot.active() == {"drive", "tour"}


def test_what_a_request_of_higher_priority_asked_for_outlives_others(robot):
    robot.declare(
        {"mission": service(0.1, "1Gi", 90), "camera": service(0.6, "1Gi", 10), "radio": service(0.6, "1Gi", 40)},
        policies=POLICY,
    )
    robot.request("mission", "radio")
    robot.wait(lambda: "mission" in robot.active())
    robot.request("camera", id="look", by="mission")
    robot.wait(lambda: len(robot.active()) == 3)
    robot.sim.extra = (1.0, 0)
    robot.wait(lambda: "radio" not in robot.active(), 20)
    assert robot.active() == {"mission", "camera"}


def test_a_service_that_is_too_much_each_time_comes_back_less_and_less_often(robot):
    robot.declare({"map": service(0.5, "1Gi", 70, protected=True), "log": service(0.6, "1Gi", 20)}, policies=POLICY)
    robot.request("map", "log")
    robot.wait(lambda: len(robot.active()) == 2)
    end = robot.now() + 600
    while robot.now() < end:
        # Other programs use more whenever it runs, so that the room it seems to have is never there.
        robot.sim.extra = (1.2 if "log" in robot.active() else 0.1, 0)
        robot.sim.run(lambda r, until=robot.now() + 0.4: r.now > until, 10)
    starts = [at for at, text in robot.sim.log if text.startswith("> start log")]
    assert len(starts) < 12, "bounded"


def test_nobody_is_shed_for_what_is_being_started(robot):
    """A program may use much before its start is told: until then that seems to be used by nobody of ours."""
    robot.declare({"map": service(0.1, "1Gi", 70), "log": service(0.1, "1Gi", 20)}, policies=POLICY)
    robot.request("map", id="map")
    robot.wait(lambda: robot.active() == {"map"})
    robot.sim.faults.hang["start", "log"] = 5.0
    robot.request("log", id="log")
    robot.wait(lambda: "log" in robot.sim.memory.in_flight)
    robot.sim.extra = (0.0, int(3.5 * GIB))
    robot.wait(lambda: "log" in robot.active())
    robot.sim.extra = (0.0, int(2.5 * GIB))
    robot.wait(lambda: robot.active() == {"map"})
    assert not any(text.startswith(("# stop map", '" pause map')) for _, text in robot.sim.log)


def test_a_start_that_hangs_keeps_no_machine_over_its_budget(robot):
    robot.declare({"map": service(0.1, "1Gi", 70), "log": service(0.1, "1Gi", 20)}, policies=POLICY)
    robot.request("map", id="map")
    robot.wait(lambda: robot.active() == {"map"})
    robot.sim.faults.hang["start", "log"] = 600.0
    robot.request("log", id="log")
    robot.wait(lambda: "log" in robot.sim.memory.in_flight)
    robot.sim.extra = (0.0, int(3.5 * GIB))
    began = robot.now()
    robot.wait(lambda: "map" not in robot.active(), 100)
    assert PATIENCE - 1 < robot.now() - began < PATIENCE + 10


def burner(cpu: float, hoard: int, priority: int, **more) -> dict:
    return {
        "command": BURN,
        "priority": priority,
        "container": {"environment": {"BURN": str(cpu), "HOARD": str(hoard)}},
        **more,
    }


@pytest.mark.parametrize("short", ["cpu", "memory"])
def test_a_machine_over_its_budget_comes_back_under_it_on_docker(dockerd, slice_of_its_own, tmp_path, short):
    """Real load, and nothing else that this machine does. The budget is above what the services use without the
    burners of low priority."""
    robot = RealRobot(tmp_path, "docker", dockerd.host, look=slice_of_its_own.look)
    budget = {"cpu": 1.2} if short == "cpu" else {"memory": 700 << 20, "cpu": 64}
    load = (0.8, 0) if short == "cpu" else (0.01, 500)
    try:
        robot.declare(
            {
                name: {**spec, "container": {**spec["container"], "cgroup_parent": slice_of_its_own.name}}
                for name, spec in {
                    "drive": burner(0.3, 50, 90, protected=True),
                    "map": burner(0.1, 50, 70),
                    "aa": burner(*load, 20),
                    "bb": burner(*load, 30, idle={"action": "pause"}),
                }.items()
            },
            policies={
                "policy": {"budget": budget, "pressure": {"calm": "2s", "memory_some": 100, "low": 0.95, "admit": 0}}
            },
        )
        robot.request("drive", "map", id="work")
        robot.wait(lambda: robot.active() == {"drive", "map"})
        robot.settle()
        before = {c.service: c.incarnation for c in robot.containers() if c.alive}
        robot.request("aa", "bb", id="load")
        robot.wait(lambda: {"aa", "bb"} <= robot.active())
        robot.wait(lambda: robot.status()["pressure"]["reason"] != "")
        robot.wait(lambda: len({"aa", "bb"} & robot.active()) < 2)
        robot.wait(lambda: not over(robot, budget))
        assert {c.service: c.incarnation for c in robot.containers() if c.service in before} == before
        assert "drive" in robot.active()
        robot.release("load")
        robot.wait(lambda: robot.status()["pressure"]["measures"] == [], 60)
        robot.wait(lambda: robot.active() == {"drive", "map"})
        robot.wait(lambda: all(c.live.get("cpu_shares", 0) in (0, 1024) for c in robot.containers()))
        assert {c.service: c.incarnation for c in robot.containers() if c.service in before} == before
    finally:
        robot.close()


def over(robot, budget: dict) -> bool:
    """Whether the services, which are what rorg can do something about, use more than the budget."""
    before, began = robot.loop.running.use(), time.monotonic()
    wait_for(lambda: time.monotonic() > began + 0.5)
    after = robot.loop.running.use()
    cpu = sum(after[n][0] - before[n][0] for n in after if n in before) / (time.monotonic() - began)
    return cpu > budget["cpu"] or robot.loop.sampler.latest.memory > budget.get("memory", float("inf"))
