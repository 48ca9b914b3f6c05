"""The first afternoon: the tutorial's commands, word for word, where there is nothing but Python and git."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import docker
import pytest
from conftest import ROOT

PAGE = ROOT / "docs/tutorial.md"
SAID = "-- said by: "
PREPARE = f"""set -e
cp /wheels/*.whl .
git config --global user.name you
git config --global user.email you@localhost
trap 'echo "{SAID}failed"' ERR
"""
BEGUN = "timeout 60 sh -c 'until [ -S /run/rorg/rorg.sock ]; do sleep 0.1; done'"
"""A person takes longer than that to go on."""
AT_THE_END = f"""
wait
echo '{SAID}processes'
ps -e -o args= | grep '[s]leep' || true
echo '{SAID}files'
find / -xdev -type f -newer /wheels/began -not -path "*/rorg-venv/*" -not -path "$HOME/robot/*" || true
echo '{SAID}end'
"""
KNOWN = {"/root/.gitconfig", "/etc/hostname", "/etc/resolv.conf", "/etc/hosts", "/.dockerenv"}
"""Of the test and of the container."""


def steps() -> list[tuple[str, list[str]]]:
    """(command, lines that its output must hold) of all consoles of the page."""
    found: list[tuple[str, list[str]]] = []
    for block in re.findall(r"```console\n(.*?)```", PAGE.read_text(), re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append((line[2:], []))
            else:
                found[-1][1].append(line)
    return found


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


def test_the_wheel_holds_the_client_the_demo_and_the_first_robot(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    for name in (
        "rorg_client/__init__.py",
        "rorg_client/py.typed",
        "rorg/cli/demo/tritonbot/manifests/services/roscore.yaml",
        "rorg/cli/demo/tritonbot/images/standin/standin",
        "rorg/cli/first_robot/services/navigation.yaml",
        "rorg/manifest/profiles/common.yaml",
    ):
        assert name in names
    assert not [name for name in names if name.startswith(("tests/", "docs/"))]


def test_the_tutorial_word_for_word(dockerd, rorg_image, wheel, tmp_path):
    """In a container with Python and git; at its end nothing is left but the robot's own tree."""
    lines = [
        f"{command}\n{BEGUN}" if command.endswith("&") else f"echo '{SAID}{number}'\n{command}"
        for number, (command, _) in enumerate(steps())
    ]
    shutil.copy(wheel, tmp_path)
    (tmp_path / "script").write_text(PREPARE + "\n".join(lines) + AT_THE_END)
    (tmp_path / "began").touch()
    said = run(dockerd.host, rorg_image, tmp_path)
    parts = dict(re.findall(rf"^{SAID}(\w+)\n(.*?)(?=^{SAID}|\Z)", said, re.DOTALL | re.MULTILINE))
    for number, (command, expected) in enumerate(steps()):
        told = parts.get(str(number), "")
        for line in expected:
            assert is_in(line, told), f"$ {command}\n{told}\nnot in it: {line}\n{said[-2000:]}"
    assert "end" in parts, said[-3000:]
    assert not parts["processes"]
    wheels = set(parts["files"].split())
    assert not {name for name in wheels if not name.startswith("/root/rorg-") and name not in KNOWN}, wheels


def is_in(expected: str, told: str) -> bool:
    """Whether these words stand there one after the other, however they are spaced and whatever stands beside them."""
    return " ".join(expected.split()) in " ".join(told.split())


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
