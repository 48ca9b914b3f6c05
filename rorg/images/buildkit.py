"""Builds with BuildKit, through the docker command, because the engine's API for it is not public."""

from __future__ import annotations

import functools
import os
import re
import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from rorg.images.cancel import Cancellation, run_command
from rorg.images.context import copy_context
from rorg.images.ignore import NAME
from rorg.images.order import Order, Say, StepFailed
from rorg.model.catalog import Image

PATIENCE = 60.0
"""Seconds for the docker command to say whether it supports BuildKit."""
STEP = re.compile(r"#(\d+) (\[(?!internal).*)")
"""The line that starts an instruction, such as `#5 [2/3] COPY a /a`."""
ERROR = re.compile(r"#(\d+) ERROR: (.*)")
OWN = re.compile(r"PATH|HOME|DOCKER_.*|BUILDKIT_.*|BUILDX_.*|.*_proxy", re.IGNORECASE)
"""Variables that have a meaning for the docker command itself."""


def find_command() -> str:
    """A docker command that can use BuildKit: 20.10 has it built in, newer ones need buildx. Empty if there is none."""
    return _find(os.environ.get("PATH", os.defpath))


@functools.cache
def _find(path: str) -> str:
    for folder in path.split(os.pathsep):
        command = os.path.join(folder, "docker")
        if os.access(command, os.X_OK) and _can(command):
            return command
    return ""


def _can(command: str) -> bool:
    with tempfile.TemporaryDirectory(prefix="rorg-build-") as folder:
        try:
            said = subprocess.run(
                [command, "build", "--help"],
                env=environment("unix:///nowhere", folder),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=PATIENCE,
            )
        except (OSError, subprocess.SubprocessError):
            return False
    return said.returncode == 0 and b"--progress" in said.stdout


def environment(host: str, folder: str) -> dict[str, str]:
    """The environment of the docker command. It talks to the same engine as rorg, but does not get the user's
    configuration: a build needs no credentials, because its bases have been pulled already."""
    scheme, _, rest = host.rpartition("://")
    encrypted = scheme == "https" or (bool(os.environ.get("DOCKER_TLS_VERIFY")) and "unix" not in scheme)
    certificates = os.environ.get("DOCKER_CERT_PATH") or str(Path.home() / ".docker")
    return {
        "PATH": os.environ.get("PATH", os.defpath),
        "HOME": folder,
        "DOCKER_CONFIG": folder,
        "DOCKER_HOST": f"{'unix' if 'unix' in scheme else 'tcp'}://{rest}",
        "DOCKER_BUILDKIT": "1",
        **({"DOCKER_TLS_VERIFY": "1", "DOCKER_CERT_PATH": certificates} if encrypted else {}),
    }


def build(
    command: str, host: str, order: Order, image: Image, *, dockerfile: bytes, say: Say, cancellation: Cancellation
) -> str:
    """The id of the image. Raises StepFailed, and OSError for unreadable files of the context."""
    with tempfile.TemporaryDirectory(prefix="rorg-build-") as name:
        folder = Path(name)
        copy_context(Path(image.context or ""), image.dockerfile, folder / "context")
        (folder / "Dockerfile").write_bytes(dockerfile)
        (folder / f"Dockerfile{NAME}").touch()  # overrides the .dockerignore of the context, which is applied already
        (folder / "config").mkdir()
        line, values = command_line(order, image, folder)
        _run([command, *line], {**environment(host, str(folder / "config")), **values}, order, say, cancellation)
        return (folder / "id").read_text().strip()


def command_line(order: Order, image: Image, folder: Path) -> tuple[list[str], dict[str, str]]:
    """(arguments, variables). Values of build arguments are variables, because anyone can read a command line."""
    values = {key: value for key, value in image.args.items() if not OWN.fullmatch(key)}
    said = [key if key in values else f"{key}={value}" for key, value in image.args.items()]
    options = {
        "--tag": [order.reference],
        "--file": [str(folder / "Dockerfile")],
        "--iidfile": [str(folder / "id")],
        "--progress": ["plain"],
        "--network": ["host"],
        "--build-arg": said,
        "--cache-from": list(image.cache_from),
        "--label": [f"{key}={value}" for key, value in order.labels.items()],
        "--target": [image.target] if image.target else [],
        "--platform": [image.platform] if image.platform else [],
    }
    words = [word for option, each in options.items() for value in each for word in (option, value)]
    return ["build", *words, *([] if order.cache else ["--no-cache"]), str(folder / "context")], values


def _run(command: list[str], variables: Mapping[str, str], order: Order, say: Say, cancellation: Cancellation) -> None:
    what = f"build {order.name}"
    # If the command is killed, the engine ends the build.
    with run_command(what, command, cancellation, stderr=subprocess.STDOUT, env=variables) as process:
        assert process.stdout
        step, why = _read((line.decode(errors="replace") for line in process.stdout), say)
    if process.returncode != 0:
        raise StepFailed(what, why, step)


def _read(lines: Iterable[str], say: Say) -> tuple[str, str]:
    """Passes on the output of the docker command: (instruction that failed, why)."""
    steps: dict[str, str] = {}
    failed, why, last = "", "", ""
    for line in lines:
        begun, error = STEP.match(line), ERROR.match(line)
        if begun and begun[1] not in steps:
            steps[begun[1]] = begun[2].strip()
        if error and not why:
            failed, why = steps.get(error[1], ""), error[2]
        say(line if not begun else steps[begun[1]], step=bool(begun))
        last = line.strip() or last
    return failed, why or last
