"""The robot of `rorg init --template ros2`, and its tutorial word for word, with real nodes on Docker."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from pathlib import Path

import docker
import pages
import pytest
from common import ROOT
from debian_images import bring_ros2

pytestmark = pytest.mark.docker
STEPS = pages.steps(ROOT / "docs/tutorial-ros2.md")
PREPARE = f"""set -e
trap 'echo "{pages.SAID}failed"; rorg down --yes; wait' ERR
git config --global user.name you
git config --global user.email you@localhost
exec 2>&1
"""
JAZZY = """FROM {image}
ENV ROS_DISTRO=jazzy
RUN mkdir -p /opt/ros/jazzy \\
 && echo 'colcon() {{ command colcon "$@" --packages-skip rorg_ros2_interfaces; }}' >/opt/ros/jazzy/setup.sh
"""
"""An image that stands for ros:jazzy, with its setup.sh. It has the interfaces already, and no compiler."""


@pytest.fixture
def jazzy(dockerd, tmp_path) -> None:
    image, context = bring_ros2(dockerd.host), tmp_path / "jazzy"
    context.mkdir()
    (context / "Dockerfile").write_text(JAZZY.format(image=image))
    api = docker.APIClient(dockerd.host, version="auto")
    lines = list(api.build(path=str(context), tag="ros:jazzy", decode=True, rm=True))
    assert api.images("ros:jazzy"), lines[-5:]


@pytest.fixture
def domain() -> Iterator[None]:
    """ROS_DOMAIN_ID 0, which other runs of these tests have one after the other."""
    with Path("/tmp/rorg-tests-domain-0.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def test_the_tutorial_word_for_word(dockerd, jazzy, domain, tmp_path):
    pages.run(STEPS, PREPARE, tmp_path, pasted=True, DOCKER_HOST=dockerd.host)
