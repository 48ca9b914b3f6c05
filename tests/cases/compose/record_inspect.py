"""Records what Compose creates of each case: CASE/inspect.json, in the form of tests/support/agreement.py.

Usage: COMPOSE=/path/to/docker-compose python tests/cases/compose/record_inspect.py [CASE...]

With Compose itself, on a private dockerd: `up --no-start` of all profiles. Images are tags of one stand-in. A case that
Compose refuses has no inspect.json. Tests need none of this.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

CASES = Path(__file__).parent
sys.path.insert(0, str(CASES.parents[1] / "support"))

import agreement  # noqa: E402
from dockerd import Dockerd, import_base  # noqa: E402
from record import arguments_of, environment_of  # noqa: E402


def record(case: Path, host: str, work: Path) -> str:
    """Writes one inspect.json; returns why there is none."""
    import docker

    folder = work / case.name
    shutil.copytree(case, folder)
    variables = {**environment_of(case), "PATH": os.environ["PATH"], "DOCKER_HOST": host}
    words = [os.environ.get("COMPOSE", "docker-compose"), *arguments_of(case)]

    def compose(*more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*words, *more], cwd=folder, env=variables, capture_output=True, text=True)

    told = compose("--profile", "*", "config", "--format", "json")
    if told.returncode:
        return told.stderr
    config: dict[str, Any] = json.loads(told.stdout)
    api = docker.APIClient(host, version="auto")
    agreement.make_images(api, agreement.images_of(config))
    agreement.make_external(api, config)
    try:
        told = compose("--profile", "*", "up", "--no-start", "--no-build", "--pull", "never")
        if told.returncode:
            return told.stderr
        label = f"com.docker.compose.project={config['name']}"
        names = [c["Names"][0].lstrip("/") for c in api.containers(all=True, filters={"label": [label]})]
        found = {"config": agreement.needed(config), **agreement.project(api, names, config, folder)}
        (case / "inspect.json").write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")
        return ""
    finally:
        compose("--profile", "*", "down", "--volumes")
        agreement.remove_external(api, config)


def main(names: list[str]) -> None:
    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    cases = [CASES / name for name in names] or sorted(p for p in CASES.iterdir() if (p / "config.json").exists())
    work = Path(tempfile.mkdtemp(prefix="rorg-record."))
    daemon = Dockerd(Path(tempfile.mkdtemp(prefix="rorg-dockerd.", dir="/tmp")))
    try:
        daemon.start()
        import_base(daemon.host)
        for case in cases:
            print(f"{case.name}: {record(case, daemon.host, work) or 'recorded'}")
    finally:
        daemon.close()
        shutil.rmtree(work)


if __name__ == "__main__":
    main(sys.argv[1:])
