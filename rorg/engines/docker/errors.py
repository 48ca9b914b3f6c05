"""The engine's errors as rorg's, each with a stable kind."""

from __future__ import annotations

import contextlib
import http.client
import re
from collections.abc import Iterator

from rorg.errors import EngineError, TimedOut, Unreachable


class Refused(Exception):
    """The engine refused: the HTTP status, and why. `cut`: there was more to read."""

    def __init__(self, status: int, text: str, cut: bool = False) -> None:
        super().__init__(text)
        self.status, self.text, self.cut = status, text, cut


class NoAnswer(OSError):
    """Nothing answers at the engine's address. Its cause is the underlying error; `seconds` is how long an answer may
    take."""

    def __init__(self, host: str, seconds: float) -> None:
        super().__init__(host)
        self.host, self.seconds = host, seconds

    @property
    def why(self) -> str:
        if isinstance(self.__cause__, TimeoutError):
            return f"no reply to a ping within {self.seconds:g} s"
        return reason(self.__cause__ or self)

    def __str__(self) -> str:
        return f"the engine at {self.host} does not answer: {self.why}"


KINDS = (
    ("missing_image", r"no such image", "`rorg build`"),
    ("no_space", r"no space left on device|disk quota exceeded", "to free space on the engine's disk"),
    (
        "name_taken",
        r"is already in use by container|name .* already in use|name conflicts with an existing object",
        "another container_name, or remove that container, which is not rorg's",
    ),
    (
        "missing_device",
        r"gathering device information|no such file or directory.*dev|stat /dev/\S+: no such file",
        "to plug the device in",
    ),
    ("forbidden", r"operation not permitted|permission denied", "an engine that may do this, or leave the option out"),
    ("forbidden", r"could not select device driver", "an engine with that runtime, or leave gpus out"),
    ("unsupported", r"freezer not supported|cannot toggle freezer|cannot be paused", "idle: {action: stop}"),
    ("gone", r"no such container|no container with name or ID|service \S+ not found", ""),
    ("conflict", r"update out of sequence", ""),
    ("conflict", r"is paused|not running|already (started|paused)|is not paused|container state improper", ""),
    ("unsupported", r"client version .* is too old", "a newer rorg: this engine has only newer forms of its API"),
    # Podman looked at a process that ended meanwhile.
    ("ending", r"/proc/\d+/\S+: no such process", ""),
    # An engine that was killed during a start left these. Nothing of the program runs, and this container never will.
    # In the last case a process runs that the engine does not know.
    ("spent", r"task \S+ already exists|failed to start shim: mkdir .*: file exists", ""),
    ("left_running", r"id already in use", "a reboot, or end the program that a killed engine left"),
)
"""Pattern in the engine's message -> its stable kind, and a remedy."""
REMEDY = "`docker info` to see whether the engine runs"


MISSHAPEN = (KeyError, IndexError, TypeError, AttributeError)
"""Raised by reading JSON that has another form than the answers of Docker's API."""


@contextlib.contextmanager
def docker_errors(what: str) -> Iterator[None]:
    """Turn the engine's errors into rorg's, also those of an answer of another form than the API's."""
    try:
        yield
    except Refused as error:
        raise refusal(what, error.text) from error
    except TimeoutError as error:
        raise TimedOut(what, "timed out", REMEDY) from error
    except (http.client.HTTPException, OSError, ValueError) as error:
        raise Unreachable(what, reason(error), REMEDY) from error
    except MISSHAPEN as error:
        why = f"the engine's answer is not one of Docker's API: {type(error).__name__}: {error}"
        raise Unreachable(what, why, "`docker version` to see what answers") from error


def refusal(what: str, text: str) -> EngineError:
    """Turn a refusal of the engine into an error of rorg."""
    for kind, pattern, remedy in KINDS:
        if re.search(pattern, text, re.I):
            return EngineError(what, text, remedy, kind)
    return EngineError(what, text)


def reason(error: BaseException) -> str:
    """Say why the engine cannot be reached."""
    known: dict[type[BaseException], str] = {
        FileNotFoundError: "its socket is missing",
        ConnectionRefusedError: "it refuses the connection",
        PermissionError: "no permission for its socket",
    }
    return known.get(type(error)) or str(error) or type(error).__name__
