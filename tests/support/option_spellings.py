"""The spellings of container options in tests/cases/options.txt, and a shell to try them."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import NamedTuple

import commands
from common import CASES

from rorg.manifest.yaml_source import read_yaml

HEAD = "apiVersion: rorg/v1\nkind: Service\nmetadata: {name: NAME}\nspec:\n  image: rorg-base\n"
HEAD += "  command: ['true']\n  PROFILE\n"

TEXT = "  container: {"


class Spelling(NamedTuple):
    name: str
    text: str
    expected: dict | None
    """None: refused."""
    place: tuple[int, int]


def spellings() -> list[Spelling]:
    found = []
    lines = (CASES / "options.txt").read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, 1):
        if not line or line.startswith("#"):
            continue
        left, arrow, right = line.partition("=>")
        column = left.find("^")
        expected = read_yaml(f"{{{right}}}", "expected")[0].value if arrow else None
        assert (column >= 0) != bool(arrow), line
        found.append(Spelling(f"case-{number}", left.strip().replace("^", ""), expected, (8, len(TEXT) + column + 1)))
    return found


SPELLINGS = spellings()


class Shell:
    def __init__(self, folder: Path, host: str = "") -> None:
        self.tree = folder / "tree"
        (self.tree / "services").mkdir(parents=True)
        self.env = {
            **os.environ,
            "RORG_STATE_DIR": str(folder / "state"),
            "RORG_ENGINE": "docker",
            "DOCKER_HOST": host,
            "TERM": "dumb",
        }

    def service(self, name: str, text: str, profile: str = "profile: plain") -> None:
        head = HEAD.replace("NAME", name).replace("PROFILE", profile)
        (self.tree / f"services/{name}.yaml").write_text(f"{head}{TEXT}{text}}}\n", encoding="utf-8")

    def __call__(self, *args: str, code: int = 0, cwd: Path | None = None) -> subprocess.CompletedProcess:
        return commands.rorg(*args, code=code, cwd=cwd, timeout=240, **self.env)
