"""What `make arm` and `make vm` share: both make a Debian bookworm in a folder, with the Python packages that rorg and
its tests need."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

sys.path.extend(str(Path(__file__).resolve().parents[1] / name) for name in (".ci", "images/rorg"))

from dependencies import ROOT, group
from wheels import selection

CONSTRAINTS = ROOT / "images/rorg/constraints.txt"


def run(*words: str | Path, **environment: str) -> None:
    """Runs a program of this machine; raises if it fails."""
    subprocess.run(words, check=True, stdin=subprocess.DEVNULL, env={**os.environ, **environment})


def install_tools(tools: Mapping[str, str]) -> None:
    """Programs, by the packages that have them, with the package manager."""
    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    missing = [package for tool, package in tools.items() if not shutil.which(tool)]
    if missing:
        print("installing:", *missing, flush=True)
        run("apt-get", "update", "-qq")
        options = ("-y", "-qq", "--no-install-recommends")
        run("apt-get", "install", *options, *missing, DEBIAN_FRONTEND="noninteractive")


def mirror() -> list[str]:
    """Where this machine's own packages come from, if it is a bookworm; otherwise debootstrap knows."""
    command = ["apt-get", "indextargets", "--format", "$(CODENAME) $(REPO_URI)", "Created-By: Packages"]
    said = subprocess.run(command, stdout=subprocess.PIPE, text=True).stdout
    return [line.split()[1] for line in said.splitlines() if line.startswith("bookworm ")][:1]


def python_packages(tools: Sequence[str]) -> list[str]:
    """The releases of test tools that pyproject.toml asks for."""
    return [tool for tool in group("test") if tool.startswith(tuple(tools))]


def key(*parts: str) -> str:
    """Names the content of something that is made of these parts and of the Python packages that rorg needs."""
    return hashlib.sha256("\n".join((CONSTRAINTS.read_text(), *parts)).encode()).hexdigest()


def install_python_packages(site: Path, architecture: str, wanted: Sequence[str]) -> None:
    """Puts what rorg needs, and these releases of test tools, into a folder, for Debian's Python 3.11."""
    shutil.rmtree(site, ignore_errors=True)
    pip = (sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile")
    options = (*selection(architecture, 11), "--target", site, "--upgrade")
    run(*pip, *options, *wanted)
    run(*pip, *options, "--require-hashes", "-r", CONSTRAINTS)
