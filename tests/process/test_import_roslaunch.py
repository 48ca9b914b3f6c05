"""`rorg import roslaunch` as a command, and what a shell makes of the words that it writes."""

from __future__ import annotations

import os
import subprocess

import commands
import pytest

from rorg.tools.importing.ros2_commands import in_shell


@pytest.mark.parametrize("word", ["", "a b", "$(id)", "`id`", "'\"$HOME", "$(find-exec sh)/x $(id)", "\\", "-n\n"])
def test_a_shell_sees_the_same_word_except_for_what_it_finds_out(word):
    done = subprocess.run(["sh", "-c", f"printf %s {in_shell(word)}"], capture_output=True, text=True, check=True)
    assert done.stdout == word.replace("$(find-exec sh)", done.stdout[: done.stdout.find("sh") + 2])


@pytest.mark.slow
def test_the_command_tells_ros_1_from_ros_2_or_asks(tmp_path):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RORG_")}

    def rorg(line: str):
        return commands.run(line.split(), environment, tmp_path)

    (tmp_path / "x.launch").write_text('<launch><arg name="a" default="$(env ARM left)"/></launch>')
    (tmp_path / "bot.launch.xml").write_text(
        '<launch><node pkg="p" exec="$(env ARM left)_arm"/><node pkg="p" exec="b"/></launch>'
    )
    asked = rorg("import roslaunch x.launch")
    assert asked.returncode == 2
    assert "try `--ros 1` or `--ros 2`" in asked.stderr
    assert "x.launch starts nothing" in rorg("import roslaunch x.launch --ros 2").stderr
    assert rorg("import roslaunch x.launch --ros 1 --output one").returncode == 0
    assert rorg("import launch x.launch --ros 1 --output two").returncode == 0, "as people call it for ROS 2"
    environment["ARM"] = "right"
    done = rorg("import roslaunch bot.launch.xml")
    assert done.returncode == 0, done.stderr
    assert "$(env ARM) has the value of this import's environment" in done.stderr
    assert rorg("validate manifests").returncode == 0
    assert "command: [ros2, run, p, right_arm]" in (tmp_path / "manifests/services/right_arm.yaml").read_text()
