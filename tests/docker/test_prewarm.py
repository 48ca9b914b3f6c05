"""A real robot starts services before they are requested, also after a restart, and says why."""

from __future__ import annotations

import time

from habits import AUTO, habits
from robots import RealRobot

from rorg.store.learned_file import NAME, read_learned, write_learned


def test_a_real_robot_knows_it_again_and_says_why(real_robot):
    write_learned(real_robot.state.path, habits(("wheels", 6.0)))
    real_robot.declare({"ears": {}, "wheels": AUTO})
    real_robot.wait(lambda: "wheels" in real_robot.states())
    real_robot.request("ears")
    real_robot.wait(lambda: real_robot.active() == {"ears", "wheels"})
    real_robot.wait(lambda: "prewarmed: developer asks for it" in real_robot.status()["services"]["wheels"]["why"])
    run = real_robot.run_of("wheels")
    real_robot.request("wheels", id="drive")
    real_robot.wait(lambda: "requested" in real_robot.status()["services"]["wheels"]["why"])
    assert real_robot.run_of("wheels") == run
    real_robot.stop()
    kept = read_learned(real_robot.state.path)
    assert kept.of("developer", ("ears",)) == habits(("wheels", 6.0)).of("developer", ("ears",))
    assert "start" in kept.took["wheels"]


def test_without_a_file_it_is_learnt_from_the_journal(request, tmp_path):
    robot = RealRobot(tmp_path, "process", None)
    request.addfinalizer(robot.close)
    robot.declare({"ears": {}, "wheels": {}})
    robot.wait(lambda: len(robot.states()) == 2)
    for service in ("ears", "wheels", "ears"):
        robot.request(service)
        robot.wait(lambda name=service: robot.active() == {name})
        end = time.monotonic() + 1.2  # what is shorter is a step on the way
        robot.wait(lambda end=end: time.monotonic() > end)
    robot.release()
    robot.wait(lambda: not robot.active())
    robot.stop()
    (robot.state.path / NAME).unlink()
    robot.start()
    found = robot.loop.learner.learned.of("developer", ("ears",))
    assert [d.to for d in found] == [("wheels",), ()]
    assert all(1.0 <= d.after < 60.0 for d in found)
