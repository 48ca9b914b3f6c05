"""The engine's errors as ours, each with a stable kind."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

import requests
import urllib3
from docker.errors import APIError, DockerException

from rorg.errors import EngineError, Unreachable

KINDS = (
    ("missing_image", r"no such image", "`rorg build` first"),
    ("name_taken", r"is already in use by container", "to remove or rename that container; rorg did not make it"),
    ("missing_device", r"gathering device information|no such file or directory.*dev", "to plug the device in"),
    ("forbidden", r"operation not permitted|permission denied", "an engine that may do this, or to drop the option"),
    ("forbidden", r"could not select device driver", "an engine with that runtime, or to drop gpus"),
    ("gone", r"no such container", ""),
    ("conflict", r"is paused|not running|already (started|paused)|is not paused", ""),
)
"""What the engine says, as a stable kind with a remedy."""


@contextlib.contextmanager
def docker_errors(what: str) -> Iterator[None]:
    """The engine's errors as ours."""
    try:
        yield
    except APIError as error:
        text = str(error.explanation or error)
        for kind, pattern, remedy in KINDS:
            if re.search(pattern, text, re.I):
                raise EngineError(what, text, remedy, kind) from error
        raise EngineError(what, text) from error
    except (DockerException, requests.RequestException, urllib3.exceptions.HTTPError, OSError, ValueError) as error:
        raise Unreachable(what, _reason(error), "`docker info` to see whether the engine runs") from error


def _reason(error: BaseException) -> str:
    text = str(error)
    if "timed out" in text.lower():
        return "timed out"
    match = re.search(r"(FileNotFoundError|ConnectionRefusedError|PermissionError)", text)
    known = {
        "FileNotFoundError": "its socket is not there",
        "ConnectionRefusedError": "it refuses the connection",
        "PermissionError": "no permission for its socket",
    }
    return known[match[1]] if match else text or type(error).__name__
