"""The first afternoon: the tutorial's commands, word for word, where there is nothing but Python and git."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import docker
import pages
import pytest
from common import ROOT

from rorg.cli.init import files

PAGES = [ROOT / "docs/tutorial.md", ROOT / "docs/tutorial-machines.md"]
ROS2_ROBOT = ROOT / "rorg/cli/ros2_robot"
# One stream: the engine copies the two of a container each on its own, so their lines may change places.
PREPARE = f"""exec 2>&1
set -e
cp /wheels/*.whl .
git config --global user.name you
git config --global user.email you@localhost
trap 'echo "{pages.SAID}failed"' ERR
"""
AT_THE_END = f"""
wait
echo '{pages.SAID}processes'
ps -e -o args= | grep '[s]leep' || true
echo '{pages.SAID}files'
find / -xdev -type f -newer /wheels/began -not -path "*/rorg-venv/*" -not -path "$HOME/robot/*" || true
echo '{pages.SAID}end'
"""
KNOWN = {
    "/var/lib/rorg/instance",
    "/var/lib/rorg/requests.yaml",
    "/var/lib/rorg/journal.db",
    *(
        f"/root/{machine}/{name}"
        for machine in ("body", "head")
        for name in ("instance", "machine.json", "requests.yaml", "journal.db")
    ),
    *(f"/root/{name}.log" for name in ("run", "body", "head")),
    "/root/.gitconfig",
    "/etc/hostname",
    "/etc/resolv.conf",
    "/etc/hosts",
    "/.dockerenv",
}
"""Of a robot that was taken down, of the test, and of the container."""


@pytest.fixture(scope="session")
def wheel(once) -> Path:
    """The wheel, made of the source distribution."""

    def make(folder: Path) -> None:
        done = subprocess.run(
            [sys.executable, "-m", "build", "--outdir", folder, ROOT], capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert len(list(folder.glob("*.tar.gz"))) == 1

    return next(once("wheel", make).glob("*.whl"))


@pytest.mark.slow
def test_the_wheel_holds_the_client_the_demo_and_the_first_robots(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    for name in (
        "rorg_client/__init__.py",
        "rorg_client/py.typed",
        "rorg/cli/demo/tritonbot/manifests/services/roscore.yaml",
        "rorg/cli/demo/tritonbot/images/standin/standin",
        "rorg/cli/first_robot/services/navigation.yaml",
        "rorg/web/page/index.html",
        "rorg/web/page/vendor/preact.js",
        "rorg/manifest/profiles/common.yaml",
        *(f"rorg/cli/ros2_robot/{path.relative_to(ROS2_ROBOT)}" for path in files(ROS2_ROBOT)),
    ):
        assert name in names, name
    assert not [name for name in names if name.startswith(("tests/", "docs/"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_tutorial_word_for_word(dockerd, rorg_image, wheel, tmp_path, page):
    """In a container with Python and git, pasted as one block; at its end nothing is left but the robot's own tree."""
    steps = pages.steps(page)
    shutil.copy(wheel, tmp_path)
    (tmp_path / "script").write_text(PREPARE + pages.script(steps) + AT_THE_END)
    (tmp_path / "began").touch()
    said = run(dockerd.host, rorg_image, tmp_path)
    parts = pages.parts(said)
    pages.check(steps, parts, said)
    assert "end" in parts, said[-3000:]
    assert not parts["processes"]
    wheels = set(parts["files"].split())
    assert not {name for name in wheels if not name.startswith("/root/rorg-") and name not in KNOWN}, wheels


def run(host: str, image: str, folder: Path) -> str:
    """What the script says in a container of its own. Packages that pip fetched before are not fetched again."""
    api = docker.APIClient(host, version="auto")
    cache = subprocess.check_output([sys.executable, "-m", "pip", "cache", "dir"], text=True).strip()
    binds, environment = (
        [f"{folder}:/wheels:ro", f"{cache}:/cache"],
        {"PATH": "/usr/bin:/bin", "PIP_CACHE_DIR": "/cache"},
    )
    authority = os.environ.get("PIP_CERT")
    if authority:
        binds.append(f"{authority}:/authority.pem:ro")
        environment["PIP_CERT"] = "/authority.pem"
    made = api.create_container(
        image,
        entrypoint=["bash", "/wheels/script"],
        working_dir="/root",
        environment=environment,
        host_config=api.create_host_config(network_mode="host", binds=binds, init=True),
    )["Id"]
    try:
        api.start(made)
        api.wait(made, timeout=300)
        return str(api.logs(made).decode(errors="replace"))
    finally:
        api.remove_container(made, force=True)
