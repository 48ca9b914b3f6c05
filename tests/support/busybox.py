"""An image with busybox, from this machine."""

from __future__ import annotations

import shutil
from pathlib import Path

import docker
from common import BASE_IMAGE


def build_busybox(host: str, context: Path) -> None:
    """An image that has what the robot's commands call; no registry is asked."""
    context.mkdir()
    for name, does in (("sleep", "time.sleep(float(sys.argv[1]))"), ("date", "print(int(time.time()))")):
        (context / name).write_text(f"#!/usr/bin/env -S python3 -S\nimport sys, time\n{does}\n")
        (context / name).chmod(0o755)
    (context / "Dockerfile").write_text(f"FROM {BASE_IMAGE}\nCOPY sleep date /usr/bin/\n")
    api = docker.APIClient(host, version="auto")
    lines = list(api.build(path=str(context), tag="busybox:stable", decode=True, rm=True))
    assert api.images("busybox:stable"), lines[-5:]
    shutil.rmtree(context)
