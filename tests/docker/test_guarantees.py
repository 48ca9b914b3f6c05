"""What a robot may rely on: strangers untouched, slow calls harmless, mistakes without effect."""

from __future__ import annotations

import shutil
import subprocess
import time

import pytest
from common import BASE_IMAGE, ROOT, wait_for
from robots import WORK, write_tree

from rorg.model.catalog import Request


def git(folder, *args):
    subprocess.run(
        ["git", "-c", "user.name=test", "-c", "user.email=test@localhost", *args],
        cwd=folder,
        check=True,
        capture_output=True,
    )


def test_a_container_without_our_label_is_never_touched(docker_robot):
    robot = docker_robot
    api = robot.engine.api()
    stranger = api.create_container(
        BASE_IMAGE, WORK, name="camera", labels={"rorg.io/owner": "another", "rorg.io/service": "camera"}
    )["Id"]
    api.start(stranger)
    try:
        robot.declare({"camera": {"always_on": True}, "mapper": {"always_on": True}})
        robot.wait(lambda: robot.active() == {"mapper"})
        robot.wait(
            lambda: any("camera is stalled" in line and "belongs to another rorg" in line for line in robot.lines)
        )
        assert {c.service for c in robot.containers()} == {"mapper"}
        assert robot.engine.inspect(stranger) is None
        robot.declare({"mapper": {"always_on": True}})
        robot.settle()
        state = api.inspect_container(stranger)["State"]
        assert state["Running"]
        assert not state["Paused"]
    finally:
        api.remove_container(stranger, force=True)


def test_a_start_that_hangs_delays_no_other_service_sim(tmp_path):
    from robots import VirtualRobot

    robot = VirtualRobot(tmp_path)
    robot.declare({"stuck": {}, "camera": {}, "mapper": {"idle": {"action": "pause"}}})
    robot.settle()
    robot.sim.faults.hang["start", "stuck"] = 60.0
    robot.request("stuck", id="one")
    robot.sim.step()
    began = robot.sim.now
    robot.request("camera", id="two")
    robot.wait(lambda: "camera" in robot.active())
    assert robot.sim.now - began - robot.sim.engine.latency("start", "camera") < 0.1
    robot.wait(lambda: "stuck" in robot.active(), 100)
    assert robot.sim.now - began >= 60


def test_eight_starts_that_hang_leave_places_for_others(tmp_path):
    """Calls that wait for something stop counting as load."""
    from robots import VirtualRobot

    robot = VirtualRobot(tmp_path)
    stuck = [f"stuck{n}" for n in range(8)]
    robot.declare({**{name: {} for name in stuck}, "camera": {}})
    robot.settle()
    robot.sim.faults.hang.update({("start", name): 60.0 for name in stuck})
    robot.request(*stuck, id="one")
    robot.sim.step()
    began = robot.sim.now
    robot.request("camera", id="two")
    robot.wait(lambda: "camera" in robot.active())
    assert robot.sim.now - began < 6


@pytest.mark.docker_only("its API takes no runtime, and so none that hangs")
def test_a_start_that_hangs_delays_no_other_service_on_docker(docker_robot, dockerd):
    """Compared with the same request in the same run while nothing hangs."""
    if not hasattr(dockerd, "folder"):
        pytest.skip("the engine is not ours to give a runtime that hangs")
    robot, hold = docker_robot, dockerd.folder / "hold"
    robot.declare({"stuck": {"container": {"runtime": "hang"}}, "camera": {"idle": {"action": "pause"}}})
    robot.settle()

    def state(name: str) -> str:
        return next(c.state for c in robot.loop.observer.snapshot().containers if c.service == name)

    def response() -> float:
        began = time.monotonic()
        robot.request("camera", id="look")
        robot.wait(lambda: state("camera") == "running")
        took = time.monotonic() - began
        robot.release("look")
        robot.wait(lambda: state("camera") == "paused" and "camera" not in robot.loop.running.memory.in_flight)
        return took

    response()
    quiet = sorted(response() for _ in range(9))[4]
    hold.touch()
    try:
        robot.request("stuck", id="one")
        robot.wait(lambda: "stuck" in robot.loop.running.memory.in_flight)
        meanwhile = sorted(response() for _ in range(9))[4]
        assert "stuck" in robot.loop.running.memory.in_flight, "the start was over: nothing was shown"
        assert meanwhile < 2 * quiet + 0.1
        # Even a rorg that starts now sees all others.
        assert {c.service for c in robot.engine.list()} == {"stuck", "camera"}
    finally:
        hold.unlink()
    robot.wait(lambda: state("stuck") == "running")


def test_a_stop_that_takes_long_delays_no_request_on_docker(docker_robot):
    """The same on Docker: a service that ignores its signals takes seconds to stop."""
    robot = docker_robot
    deaf = [
        "python3",
        "-S",
        "-c",
        "import signal\nfor s in (2,15): signal.signal(s, signal.SIG_IGN)\n"
        "print('deaf', flush=True)\nwhile True: signal.pause()",
    ]
    grace = {"stop_grace_period": "100s"}
    robot.declare({"deaf": {"command": deaf, "container": grace}, "camera": {"idle": {"action": "pause"}}})
    robot.settle()
    robot.request("deaf", "camera")
    robot.wait(lambda: robot.active() == {"deaf", "camera"})
    robot.wait(
        lambda: (
            b"deaf"
            in b"".join(line.text for line in robot.engine.log_lines(robot.container("deaf").id, None, None, False))
        )
    )
    robot.settle()
    robot.release()
    robot.wait(lambda: robot.states()["camera"] == "paused" and "deaf" in robot.loop.running.memory.in_flight)
    robot.request("camera", id="again")
    robot.wait(lambda: "camera" in robot.active(), 30)
    assert "deaf" in robot.loop.running.memory.in_flight, "the slow stop was over: nothing was shown"
    robot.kill("deaf")
    robot.wait(lambda: robot.states()["deaf"] == "exited")


@pytest.mark.slow
def test_a_wrong_manifest_changes_nothing(real_robot):
    """Every broken tree takes the place of the good one in turn; nothing is stopped, removed or begun."""
    robot = real_robot
    robot.declare({"camera": {"always_on": True}, "mapper": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"camera", "mapper"})
    robot.settle()
    before = [(c.service, c.incarnation, c.state) for c in robot.containers()]
    actions = len(robot.lines)
    cases = sorted(p.parent for p in (ROOT / "tests" / "cases" / "broken").glob("*/expected"))
    assert len(cases) >= 30
    for case in cases:
        shutil.rmtree(robot.tree)
        shutil.copytree(case, robot.tree, symlinks=True)
        robot.loop.wakes.files_changed()
        robot.wait(lambda: robot.loop.tree.stamp() == robot.loop.tree._stamp)
        assert robot.loop.tree.errors, case.name
        assert [(c.service, c.incarnation, c.state) for c in robot.containers()] == before, case.name
    assert not [line for line in robot.lines[actions:] if "done in" in line]


def test_a_checkout_is_never_half_read(real_robot):
    """Two commits swap what two services need; read half-way, they would need each other."""
    robot = real_robot
    tree = robot.tree
    write_tree(tree, {"left": {"needs": ["right"]}, "right": {}})
    git(tree.parent, "init", "-q")
    git(tree.parent, "add", "-A")
    git(tree.parent, "commit", "-qm", "one")
    write_tree(tree, {"left": {}, "right": {"needs": ["left"]}})
    git(tree.parent, "commit", "-qam", "two")
    robot.start()
    robot.wait(lambda: robot.loop.tree.loaded)
    for _ in range(10):
        git(tree.parent, "checkout", "-q", "HEAD~1")
        git(tree.parent, "checkout", "-q", "-")
    git(tree.parent, "revert", "--no-edit", "HEAD")
    robot.wait(lambda: robot.loop.tree.desired.catalog.services["left"].needs == ("right",))
    assert not any("refused" in line for line in robot.lines)


def test_a_broken_edit_of_the_requests_file_keeps_the_last_good_one(real_robot):
    robot = real_robot
    robot.declare({"camera": {}})
    robot.request("camera")
    robot.wait(lambda: robot.active() == {"camera"})
    robot.settle()
    text = robot.state.requests.read_text()
    robot.state.requests.write_text(text + "- oops: [\n")
    robot.wait(lambda: any("requests.yaml" in line and "stay in force" in line for line in robot.lines))
    assert robot.active() == {"camera"}
    with pytest.raises(Exception, match="fix the file"):
        robot.request("camera", id="other")
    robot.state.requests.write_text("requests: []\n")
    robot.wait(lambda: not robot.active())


def test_a_person_may_edit_requests_while_the_loop_runs(real_robot):
    robot = real_robot
    robot.declare({"behaviour": {"always_on": True}, "camera": {}})
    robot.wait(lambda: robot.active() == {"behaviour"})
    robot.state.requests.write_text("requests:\n- {id: mine, requester: behaviour, services: [camera]}\n")
    robot.wait(lambda: robot.active() == {"behaviour", "camera"})
    wait_for(lambda: robot.requests()[0].incarnation == robot.container("behaviour").incarnation)


def test_a_missing_image_never_stops_what_runs(docker_robot):
    """The new container is made before the old one is stopped."""
    robot = docker_robot
    robot.declare({"camera": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"camera"})
    robot.settle()
    before = robot.container("camera").incarnation
    robot.declare({"camera": {"always_on": True, "image": "nowhere/to-be-found"}})
    robot.wait(lambda: "cannot be pulled" in robot.waits("camera"))
    assert robot.container("camera").incarnation == before


def test_conflicting_requests_are_refused_whole(tmp_path):
    from rorg.core.requests import Problem, ProblemCode, problems
    from rorg.manifest.load import load_or_raise

    catalog = load_or_raise(
        write_tree(
            tmp_path, {"mapper": {"conflicts": ["locator"]}, "locator": {}, "navigation": {"needs": ["locator"]}}
        )
    )
    held = [Request("one", "developer", ("mapper",))]
    found = problems(catalog, held, Request("two", "developer", ("navigation",)))
    cause = "'locator' and 'mapper' conflict and would both be wanted"
    assert found == [Problem(ProblemCode.CONFLICT, cause, "`rorg why` for who wants which")]
    assert problems(catalog, held, Request("one", "developer", ("navigation",))) == [], "a replacement is no conflict"
    assert problems(catalog, held, Request("two", "nobody", ("nothing",))) == [
        Problem(ProblemCode.UNKNOWN, f"unknown {what}", "one of developer, locator, mapper, navigation")
        for what in ("requester 'nobody'", "service 'nothing'")
    ]


def test_a_removal_that_fails_backs_off(tmp_path):
    """Also for a service that no manifest declares any more."""
    from robots import VirtualRobot

    robot = VirtualRobot(tmp_path)
    robot.declare({"camera": {}, "mapper": {}})
    robot.settle()
    robot.sim.faults.fail["remove", "camera"] = ["device or resource busy"] * 100
    robot.declare({"mapper": {}})
    robot.sim.at(60.0, lambda: None)
    robot.wait(lambda: robot.sim.now >= 60.0)
    attempts = [text for _, text in robot.sim.log if "remove camera" in text]
    assert 4 <= len(attempts) <= 10
