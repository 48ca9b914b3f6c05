"""Images on Docker: built by BuildKit or the classic builder, pulled, or imported from the output of a command."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import threading
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import IO, Any

import requests
import urllib3
from docker.errors import APIError, DockerException

from rorg.engines.docker.answers import MOST_ANSWER, from_json
from rorg.engines.docker.engine import DockerEngine
from rorg.engines.docker.errors import REMEDY, docker_errors, refusal
from rorg.errors import EngineError, RorgError, Unreachable
from rorg.images import buildkit, classic
from rorg.images.cancel import PATIENCE, Cancellation, run_command
from rorg.images.order import Order, Say
from rorg.manifest.dockerfile import DockerfileError, rewritten
from rorg.manifest.files import read_bytes
from rorg.manifest.images import machine, read_dockerfile
from rorg.model.catalog import Image
from rorg.model.image_names import plain


@contextlib.contextmanager
def library_errors(what: str) -> Iterator[None]:
    """Converts docker-py's errors into rorg's."""
    try:
        yield
    except APIError as error:
        raise refusal(what, str(error.explanation or error)) from error
    except (DockerException, requests.RequestException, urllib3.exceptions.HTTPError, OSError, ValueError) as error:
        raise Unreachable(what, str(error), REMEDY) from error


class DockerBuilder:
    """Builds with the engine that also runs the images; see Builder."""

    def __init__(self, engine: DockerEngine, buildkit: bool = True, imports: bool = True) -> None:
        """Without `buildkit`, the classic builder is used even if BuildKit is available. Without `imports`, no import
        command runs."""
        self._imports = imports
        self._engine, self._client, self._wanted = engine, engine.client, buildkit
        self._cancellation = Cancellation()
        self._found: str | None = None

    def there(self, references: Collection[str]) -> set[str]:
        return set(references) - self._engine.missing_images(references)

    def pull(self, reference: str, say: Say) -> None:
        """Pulls with docker-py, which knows where Docker's commands keep the credentials of registries."""
        what, sizes = f"pull {reference}", dict[str, tuple[int, int]]()
        with library_errors(what):
            api = self._engine.api()
            with contextlib.closing(api), contextlib.closing(api.pull(reference, stream=True, decode=True)) as lines:
                for line in lines:
                    with self._cancellation.by(lambda: None):
                        _say_progress(line, sizes, say)
                    if "error" in line:
                        raise EngineError(what, line["error"], "an Image of that name in the tree")

    def build(self, order: Order, say: Say) -> str:
        assert order.image
        command, image = self._buildkit(), order.image
        text = dockerfile_of(order, image, any_syntax=bool(command) or self._client.release.podman)
        if command:
            host, stop = self._client.host, self._cancellation
            return buildkit.build(command, host, order, image, dockerfile=text, say=say, cancellation=stop)
        return classic.build(self._client, order, image, text, say, self._cancellation)

    def _buildkit(self) -> str:
        """The docker command if the engine supports BuildKit too; otherwise empty."""
        if self._found is None:
            with docker_errors("reach the engine"):
                parts = self._client.get("/version").get("Components") or () if self._wanted else ()
            known = any(part["Name"] == "Engine" for part in parts)  # Podman has the same API, but not BuildKit
            self._found = buildkit.find_command() if known else ""
        return self._found

    def load(self, order: Order, say: Say) -> str:
        """See Builder. Tags the image only after the command has succeeded: output of a failed one is incomplete."""
        assert order.image
        what = f"import {order.name}"
        if not self._imports:
            raise EngineError(what, "a running rorg runs no commands of manifests", f"`rorg build {order.name}`")
        query: dict[str, Any] = {
            "fromSrc": "-",
            # One instruction for each label: Podman reads several of one instruction as a single label.
            "changes": tuple(f"LABEL {key}={json.dumps(value)}" for key, value in order.labels.items()),
            "platform": order.image.platform or None,
        }
        made = ""
        try:
            with (
                import_stream(order.image, self._cancellation) as archive,
                docker_errors(what),
                self._client.stream("POST", "/images/create", archive, **query) as stream,
            ):
                for line in stream.lines(MOST_ANSWER):
                    told = from_json(line)
                    if "error" in told:
                        raise EngineError(what, told["error"])
                    made = str(told.get("status", made))
        except RorgError:
            self.remove([made] if made else [])
            raise
        self.tag(made, order.reference)
        return made

    def tag(self, reference: str, also: str) -> None:
        repository, tag = _parted(also)
        with docker_errors(f"tag {reference} as {also}"):
            self._client.post(f"/images/{reference}/tag", repo=repository, tag=tag)

    def digest(self, reference: str) -> str:
        with docker_errors(f"look at {reference}"):
            inspection = self._client.get(f"/images/{reference}/json")
        name = _parted(plain(reference))[0]
        digests = {
            plain(text.partition("@")[0]): text.partition("@")[2] for text in inspection.get("RepoDigests") or ()
        }
        return str(digests.get(name) or inspection["Id"])

    def remove(self, references: Collection[str]) -> None:
        for reference in references:
            with contextlib.suppress(RorgError), docker_errors(f"remove {reference}"):
                self._client.delete(f"/images/{reference}", force=True)

    def cancel(self) -> None:
        self._cancellation.cancel()

    def close(self) -> None:
        self._client.close()


def _parted(reference: str) -> tuple[str, str]:
    """(repository, tag) of a reference."""
    name, colon, tag = reference.rpartition(":")
    return (name, tag) if colon and "/" not in tag else (reference, "latest")


def _say_progress(line: dict[str, Any], sizes: dict[str, tuple[int, int]], say: Say) -> None:
    """Reports how much of all layers has been downloaded."""
    detail = line.get("progressDetail") or {}
    if line.get("status") == "Downloading" and "total" in detail:
        sizes[line["id"]] = int(detail["current"]), int(detail["total"])
        come, whole = (sum(each) / 1e6 for each in zip(*sizes.values(), strict=True))
        say(f"{come:.1f} of {whole:.1f} MB", step=True)


def dockerfile_of(order: Order, image: Image, any_syntax: bool) -> bytes:
    """The Dockerfile that the engine gets, with the references in force. Without `any_syntax`, what needs BuildKit is
    refused: Docker's first builder would misread some of it. Podman itself refuses what it cannot build. Raises OSError
    if the file cannot be read, and EngineError if it is invalid or refused."""
    if image.inline:
        return image.inline.encode()
    context = Path(image.context or "")
    # surrogateescape keeps any bytes, which encode() below restores
    text = read_bytes(context / image.dockerfile, context).decode(errors="surrogateescape")
    try:
        if not any_syntax and read_dockerfile(text, image).buildkit:
            remedy = "to install the docker command with buildx (in Debian's docker.io), and an engine by Docker"
            raise EngineError(f"build {image.name}", f"{image.dockerfile} needs BuildKit, which is missing", remedy)
        now = order.replacements
        stand_ins = {name: now.get(reference, reference) for name, reference in image.stand_ins.items()}
        dockerfile = rewritten(text, image.args, {**now, **stand_ins}, image.target, image.platform, machine())
    except DockerfileError as error:
        raise EngineError(f"build {image.name}", f"{image.dockerfile}:{error.line}: {error}") from error
    return dockerfile.encode(errors="surrogateescape")


SAID = 500
"""Bytes of the last output of a failed import command that are shown."""


@contextlib.contextmanager
def import_stream(image: Image, cancellation: Cancellation | None = None) -> Iterator[IO[bytes]]:
    """Runs an image's import command during the block; its standard output is the tar stream. If the command fails,
    raises EngineError with its last error output."""
    what, remedy, command = f"import {image.name}", "to fix spec.import", image.import_command or ()
    said, pipe, where = bytearray(), subprocess.PIPE, image.directory
    running = run_command(what, command, cancellation or Cancellation(), stderr=pipe, cwd=where, remedy=remedy)
    with running as process:
        listener = threading.Thread(target=_listen, args=(process.stderr, said), daemon=True)
        listener.start()
        assert process.stdout
        yield process.stdout
    listener.join(PATIENCE)
    if process.returncode != 0:
        why = said.decode(errors="replace").strip()
        raise EngineError(what, why or f"exit code {process.returncode}", remedy)


def _listen(pipe: IO[bytes], said: bytearray) -> None:
    """Keeps the end of a command's error output, and reads all of it so that the command never blocks."""
    with pipe:
        while chunk := os.read(pipe.fileno(), 1 << 16):
            said[:] = (said + chunk)[-SAID:]
