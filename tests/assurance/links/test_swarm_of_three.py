"""A Swarm of three, each in a network of its own, and an rorg for what may run on any of them. What runs is read from
the engines, not from the Swarm. `make machines` runs it."""

from __future__ import annotations

import shutil
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from common import free_port, wait_for
from computers import Computer, Team
from links.swarms import Swarm
from robots import WORK

NAMES = ("one", "two", "three")
COUNT = 100
SERVICES = {f"worker{n:03}": {"machine": "any"} for n in range(COUNT)}
ROBOT = {"tour": {"machine": "base", "needs": ["planner"]}, "planner": {"machine": "any"}}


class Robot:
    """A computer with the process engine, and the rorg that has the Swarm."""

    def __init__(self, folder: Path) -> None:
        self.swarm = Swarm(folder, NAMES)
        self.hosts = ",".join(node.host for node in self.swarm.nodes.values())
        self.team = Team(folder, {**SERVICES, **ROBOT}, ("base", "any"), make=self._computer)
        self.any, self.base = self.team.computers["any"], self.team.computers["base"]

    def _computer(self, folder: Path, name: str) -> Computer:
        made = Computer(folder, name, f"127.0.0.1:{free_port()}", "swarm" if name == "any" else "process")
        made.environment["RORG_SWARM_MANAGERS"] = self.hosts
        return made

    def all_run_once(self) -> bool:
        running = self.swarm.running()
        return all(len(running.get(name, ())) == 1 for name in SERVICES)

    def close(self) -> None:
        self.team.stop()
        self.swarm.close()


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    folder = Path(tempfile.mkdtemp(prefix="rorg-dockerd."))
    made = Robot(folder)
    made.team.start()
    yield made
    made.close()
    shutil.rmtree(folder, ignore_errors=True)


def by_swarm_alone(robot: Robot) -> float:
    """Seconds that the Swarm takes for as many services by its own commands, called one after another."""
    api, began = robot.swarm.managers[0].api(), time.monotonic()
    import docker

    made = []
    for n in range(COUNT):
        inside = docker.types.ContainerSpec("rorg-base", command=WORK, init=True, stop_signal="SIGINT")
        template = docker.types.TaskTemplate(inside, networks=[{"Target": "host"}])
        made.append(
            api.create_service(template, name=f"alone{n}", mode=docker.types.ServiceMode("replicated", 1))["ID"]
        )

    def running() -> bool:
        rows = api.tasks(filters={"desired-state": "running"})
        return sum(t["Status"]["State"] == "running" for t in rows if t["ServiceID"] in made) == COUNT

    wait_for(running, 120, "the Swarm to run its own")
    took = time.monotonic() - began
    for service in made:
        api.remove_service(service)
    wait_for(lambda: "other" not in robot.swarm.running(), 120, "the Swarm's own to end")
    return took


def test_a_hundred_services_from_nothing(robot):
    alone = by_swarm_alone(robot)
    began = time.monotonic()
    robot.any.ask("all", *SERVICES)
    robot.any.wait(*SERVICES, timeout=120)
    took = time.monotonic() - began
    wait_for(robot.all_run_once, 30, "each to run once, by the engines")
    print(f"swarm: {COUNT} services ready after {took:.1f} s; the Swarm alone takes {alone:.1f} s")
    assert took < 3 * alone + 5


def test_a_service_of_the_robot_needs_one_that_runs_anywhere(robot):
    took = []
    for number in range(5):
        began = time.monotonic()
        robot.base.ask(f"r{number}", "tour")
        robot.base.wait("tour")
        took.append(time.monotonic() - began)
        robot.base.client.release(f"r{number}")
        wait_for(lambda: robot.any.state("planner") == "exited", 30, "the planner to stop")
    print(f"swarm: a request from the robot is ready after {statistics.median(took):.2f} s")
    chain = robot.base.client.why("planner")[0]
    assert not chain["wanted"]


@pytest.mark.parametrize("lead", [False, True], ids=["follower", "leader"])
def test_a_killed_node_is_replaced_by_the_swarm_and_comes_back(robot, lead):
    """rorg plans nothing for it: the Swarm moves its tasks. The rorg follows another manager if its own is gone."""
    leader = robot.swarm.leader()
    victim = leader if lead else next(n for n in robot.swarm.managers if n is not leader)
    before = {n: where[0] for n, where in robot.swarm.running().items()}
    made = len(robot.any.events("done"))
    began = time.monotonic()
    victim.kill()
    wait_for(robot.all_run_once, 120, "all to run on the other two")
    took = time.monotonic() - began
    moved = [n for n, where in before.items() if where == victim.name]
    wait_for(lambda: all(robot.any.ready(n) for n in SERVICES), 60, "rorg to see it")
    print(f"swarm: {len(moved)} services of the killed {victim.name} run elsewhere after {took:.1f} s")
    assert len(robot.any.events("done")) == made, "the Swarm did it, and rorg repeated nothing"
    stayed = [n for n, where in before.items() if where != victim.name]
    now = {n: where[0] for n, where in robot.swarm.running().items()}
    assert all(now[n] == before[n] for n in stayed)
    # A change is made while a manager is away.
    robot.any.ask("planned", "planner")
    robot.any.wait("planner", timeout=60)
    robot.any.client.release("planned")
    victim.start()
    wait_for(lambda: len(robot.swarm.ready(robot.swarm.leader())) == len(NAMES), 60, "it to be back")
    wait_for(robot.all_run_once, 60, "each to run once")


def test_without_most_managers_nothing_is_known_and_nothing_is_done(robot):
    frozen = [node for node in robot.swarm.managers[1:]]
    plan = robot.any.client.plan()["actions"]
    assert plan == []
    made = len(robot.any.events("done"))
    for node in frozen:
        node.freeze()
    began = time.monotonic()

    def silent() -> bool:
        return bool(robot.any.client.call("GET", "/v1/status")["engine"]["error"])

    wait_for(silent, 60, "rorg to say that the Swarm does not answer")
    told = time.monotonic() - began
    robot.any.client.release("all")  # what is asked for meanwhile is done afterwards
    robot.any.ask("half", *list(SERVICES)[: COUNT // 2])
    ended = time.monotonic() + 20
    wait_for(lambda: time.monotonic() > ended, 40, "the quorum to stay away")
    assert len(robot.any.events("done")) == made
    states = {robot.base.state("planner"), *(robot.base.state(n) for n in list(SERVICES)[:5])}
    for node in frozen:
        node.thaw()
    back = time.monotonic()
    wanted = set(list(SERVICES)[: COUNT // 2])
    wait_for(lambda: set(robot.swarm.running()) == wanted, 180, "what is asked for to run, and nothing else")
    print(
        f"swarm: silence told after {told:.1f} s, the robot says {sorted(states)}; "
        f"as declared {time.monotonic() - back:.1f} s after the quorum was back"
    )
    robot.any.client.release("half")
    wait_for(lambda: robot.swarm.running() == {}, 180, "all to end")
    for computer in robot.team.computers.values():
        assert "bug:" not in computer.log.read_text()
        assert "internal error" not in computer.log.read_text()
