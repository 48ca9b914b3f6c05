"""Files of an earlier version in a state directory: nothing reads them, and `rorg down` removes them."""

from __future__ import annotations

import commands
import pytest
from common import wait_for
from rorg_process import RorgProcess


@pytest.fixture
def robot(tmp_path):
    found = RorgProcess(tmp_path, {"arm": {"always_on": True}, "cam": {"idle": {"prewarm": "auto"}}})
    yield found
    found.close()


@pytest.mark.slow
def test_a_state_directory_with_learned_requests_is_used_as_it_is(robot):
    robot.state.mkdir(parents=True)
    learned = robot.state / "learned.json"
    learned.write_text('{"version": 1, "departures": {}, "took": {}}\n')
    robot.start()
    client = robot.client(patience=30)
    client.wait("arm", timeout=30)
    run = client.service("arm")["incarnation"]
    robot.stop(kill=True)
    learned.write_text("{")
    robot.start()
    wait_for(lambda: client.service("arm")["health"] == "Healthy")
    assert client.service("arm")["incarnation"] == run
    assert learned.read_text() == "{", "nothing reads or writes it"
    commands.rorg("down", "--yes", cwd=robot.folder, RORG_STATE_DIR=str(robot.state), RORG_ENGINE="process")
    assert not learned.exists()
