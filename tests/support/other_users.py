"""Another Unix user, and commands in their name."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import rorg_client

import rorg

MEMBER, STRANGER, GROUP = 47_001, 47_002, 47_100
"""Numbers that no user of the machine has."""

_OURS = [str(Path(module.__file__).parents[1]) for module in (rorg, rorg_client)]

IMPORTED = os.pathsep.join([*_OURS, *(p for p in sys.path if p and not p.startswith(sys.base_prefix))])


def python() -> str:
    """A Python that other users may use: this one, else the system's of the same version."""
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    for found in (sys.executable, shutil.which(name, path="/usr/local/bin:/usr/bin")):
        with contextlib.suppress(OSError):
            asked = [found or "", "-c", "import rorg.cli.main, pydantic, yaml"]
            if subprocess.run(asked, user=MEMBER, cwd="/", env={"PYTHONPATH": IMPORTED}).returncode == 0:
                return str(found)
    pytest.skip("no other user can read a Python that has what rorg needs")
