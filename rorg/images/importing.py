"""Images that a command writes as a root file system."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from typing import IO

from rorg.errors import EngineError
from rorg.host.commands import end
from rorg.images.cancelling import Cancelling
from rorg.model.catalog import Image

SAID = 500
"""Bytes of the last words of an import command that failed."""
PATIENCE = 10.0
"""Seconds for which an import command may go on once its stream has been read."""


@contextlib.contextmanager
def import_stream(image: Image, cancelling: Cancelling | None = None) -> Iterator[IO[bytes]]:
    """Runs an image's import command as long as the block; its standard output is the tar stream. Raises EngineError
    with what it said last when it fails."""
    try:
        process = subprocess.Popen(
            image.import_command or (),
            cwd=image.directory,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
    except OSError as error:
        raise EngineError(f"import {image.name}", str(error), "fixing spec.import") from error
    assert process.stdout
    assert process.stderr
    said = bytearray()
    listener = threading.Thread(target=_listen, args=(process.stderr, said), daemon=True)
    listener.start()
    try:
        with (cancelling or Cancelling()).by(lambda: os.killpg(process.pid, signal.SIGKILL)):
            yield process.stdout
        process.stdout.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE)
    finally:
        end(process, signal.SIGTERM)
        listener.join(PATIENCE)
    if process.returncode != 0:
        why = said.decode(errors="replace").strip()
        raise EngineError(f"import {image.name}", why or f"exit code {process.returncode}", "fixing spec.import")


def _listen(pipe: IO[bytes], said: bytearray) -> None:
    """Keeps the end of what a command says, and never makes it wait."""
    with pipe:
        while chunk := os.read(pipe.fileno(), 1 << 16):
            said[:] = (said + chunk)[-SAID:]
