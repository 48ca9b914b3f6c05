"""A request that follows an edit gets what was saved, in one run, although the watcher tells of it later."""

from __future__ import annotations

import pytest
from robots import RealRobot, write_tree

from rorg.host.watch import Watcher


class Watched(RealRobot):
    """A robot whose `nav` is idle, and mounts a script."""

    def begin(self) -> None:
        self.conf = self.tree / "services/nav/conf"
        self.conf.parent.mkdir(parents=True)
        self.conf.write_text("0")
        self.save(0)
        self.start()
        self.wait(lambda: any(c.service == "nav" for c in self.containers()))
        self.wait(self.quiet)
        # What tells of changes late tells of them never here.
        next(thread for thread in self.loop.threads if isinstance(thread, Watcher)).stop()

    def save(self, number: int) -> None:
        nav = {"mounts": ["./nav:/conf"], "container": {"environment": {"N": str(number)}}}
        write_tree(self.tree, {"nav": nav, "other": {"always_on": True}})

    def run_with_everything(self) -> str:
        """The run of `nav`, after whatever else the loop has to do."""
        self.wait(self.quiet)
        container = self.container("nav")
        assert container.state == "running"
        assert container.digest == self.loop.tree.desired.digests["nav"]
        return container.incarnation


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.docker)])
def robot(request, tmp_path):
    host = request.getfixturevalue("dockerd").host if request.param == "docker" else None
    found = Watched(tmp_path, request.param, host, with_server=True)
    found.begin()
    yield found
    found.close()


@pytest.mark.parametrize("edit", ["manifest", "mounted"])
def test_a_request_right_after_an_edit_gets_what_was_saved(robot, edit):
    client = robot.client(patience=30.0)
    for number in range(1, 4):
        before = robot.loop.tree.desired.editions["nav"]
        if edit == "manifest":
            robot.save(number)
        else:
            robot.conf.write_text(f"{number}" * 3)
        client.request("nav", id="go", wait=30)
        assert robot.loop.tree.desired.editions["nav"] != before, "it answered for the version of before"
        answered = robot.container("nav").incarnation
        assert robot.run_with_everything() == answered, "it restarted under its requester"
        client.release("go")
        robot.wait(lambda: "nav" not in robot.active())


def test_a_wait_right_after_an_edit_of_what_runs_answers_for_the_next_run(robot):
    client = robot.client(patience=30.0)
    client.request("nav", id="go", wait=30)
    before = robot.run_with_everything()
    robot.save(7)
    client.wait("nav", timeout=30)
    assert robot.run_of("nav") != before


def test_a_file_that_never_rests_keeps_nobody_waiting(robot):
    """It is written all the time; a request waits for two seconds at most."""
    import threading

    ended, number = threading.Event(), 0

    def write() -> None:
        nonlocal number
        while not ended.wait(0.05):
            number += 1
            robot.conf.write_text(str(number))

    writer = threading.Thread(target=write)
    writer.start()
    try:
        robot.loop.wakes.files_changed()
        robot.client(patience=30.0).request("nav", id="go", wait=20)
        run = robot.run_of("nav")
        robot.client(patience=30.0).wait("nav", timeout=20)
        assert robot.run_of("nav") == run
    finally:
        ended.set()
        writer.join()
