"""The C++ client against a running rorg, and its CMake package."""

from __future__ import annotations

import os
import subprocess

import pytest
from common import ROOT
from robots import RealRobot
from tools import tool

TREE = {
    "camera": {"idle": {"action": "pause"}, "ready": {"exec": ["true"], "interval": "50ms"}},
    "lidar": {},
    "arm": {"driver": {}, "conflicts": ["lidar"]},
}
CLIENT = ROOT / "clients/cpp"


@pytest.mark.slow
@pytest.mark.parametrize("words", [["calls"], ["forks", "3"]], ids=lambda words: words[0])
def test_every_call_does_what_it_says(cpp_programs, tmp_path, words):
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    robot.declare(TREE)
    robot.wait(lambda: len(robot.containers()) == 3)
    try:
        done = subprocess.run(
            [cpp_programs / "calls", *words],
            capture_output=True,
            text=True,
            timeout=100,
            env={**os.environ, "RORG_SOCKET": robot.socket()},
        )
        assert done.returncode == 0, done.stderr
    finally:
        robot.close()


@pytest.mark.slow
def test_it_is_a_cmake_package(tmp_path):
    cmake = tool("cmake")
    tool("g++")
    subprocess.run([cmake, "-S", CLIENT, "-B", tmp_path / "plain"], check=True, capture_output=True)
    for step in (
        ["cmake", "-S", CLIENT, "-B", tmp_path / "build", "-DRORG_WITH_TLS=ON"],
        ["cmake", "--install", tmp_path / "build", "--prefix", tmp_path / "prefix"],
    ):
        subprocess.run(step, check=True, capture_output=True)
    user = tmp_path / "user"
    user.mkdir()
    (user / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.16)\nproject(user CXX)\nfind_package(rorg REQUIRED)\n"
        "add_executable(user main.cpp)\ntarget_link_libraries(user PRIVATE rorg::rorg)\n"
    )
    # Nobody is there; but TLS is, else it would be Invalid.
    (user / "main.cpp").write_text(
        "#include <rorg/rorg.hpp>\nint main() {\n  try {\n"
        '    rorg::Client("https://127.0.0.1:1", rorg::Seconds(1), rorg::Seconds(0)).services();\n'
        "  } catch (const rorg::Unreachable&) {\n    return 0;\n  }\n  return 1;\n}\n"
    )
    subprocess.run(
        ["cmake", "-S", user, "-B", user / "build", f"-DCMAKE_PREFIX_PATH={tmp_path}/prefix"],
        check=True,
        capture_output=True,
    )
    subprocess.run(["cmake", "--build", user / "build"], check=True, capture_output=True)
    assert subprocess.run([user / "build/user"]).returncode == 0
