"""Records what Docker Compose itself makes of the cases.

    COMPOSE=docker-compose python tests/cases/compose/record.py [NAME...]

Each case is a directory with Compose files, and perhaps `environment` (NAME=value lines of the process's environment)
and `arguments` (options of `docker compose`, as `-f a.yaml -f b.yaml --profile sim --env-file robot.env`). What
`config --format json` answers becomes config.json; the directory of the case is CASE in it.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
HOME = "/home/robot"


def environment_of(case: Path) -> dict[str, str]:
    """What the case says of the process's environment; nothing else is in it but HOME."""
    file = case / "environment"
    lines = file.read_text().splitlines() if file.exists() else []
    return {"HOME": HOME, **dict(line.split("=", 1) for line in lines if line)}


def arguments_of(case: Path) -> list[str]:
    file = case / "arguments"
    return shlex.split(file.read_text()) if file.exists() else []


def record(case: Path) -> str:
    """The reason why Compose refuses it; else nothing, and the answer is written."""
    command = [os.environ.get("COMPOSE", "docker-compose"), *arguments_of(case), "config", "--format", "json"]
    environment = {"PATH": os.environ["PATH"], **environment_of(case)}
    done = subprocess.run(command, cwd=case, env=environment, capture_output=True, text=True)
    if done.returncode:
        return done.stderr.strip()
    answer = json.loads(done.stdout.replace(str(case), "CASE"))
    (case / "config.json").write_text(json.dumps(answer, indent=1, sort_keys=True, ensure_ascii=False) + "\n")
    return ""


def main(names: list[str]) -> None:
    for case in sorted(path for path in HERE.iterdir() if path.is_dir()):
        if not names or case.name in names:
            refused = record(case)
            print(f"{case.name}: {refused or 'recorded'}")


if __name__ == "__main__":
    main(sys.argv[1:])
