"""The engine's errors as ours, each with a stable kind."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

import requests
import urllib3
from docker.errors import APIError, DockerException

from rorg.errors import EngineError, TimedOut, Unreachable

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
        remedy = "`docker info` to see whether the engine runs"
        if _timed_out(error):
            raise TimedOut(what, "timed out", remedy) from error
        raise Unreachable(what, _reason(error), remedy) from error


def _timed_out(error: BaseException) -> bool:
    """Whether an error of the library means that the engine took too long. What it wraps may be its cause or context,
    or only an argument."""
    pending, seen = [error], set()
    while pending:
        found = pending.pop()
        if isinstance(found, requests.Timeout | urllib3.exceptions.TimeoutError | TimeoutError):
            return True
        if id(found) not in seen:
            seen.add(id(found))
            more = (found.__cause__, found.__context__, getattr(found, "reason", None), *found.args)
            pending += [e for e in more if isinstance(e, BaseException)]
    return False


def _reason(error: BaseException) -> str:
    text = str(error)
    match = re.search(r"(FileNotFoundError|ConnectionRefusedError|PermissionError)", text)
    known = {
        "FileNotFoundError": "its socket is not there",
        "ConnectionRefusedError": "it refuses the connection",
        "PermissionError": "no permission for its socket",
    }
    return known[match[1]] if match else text or type(error).__name__
