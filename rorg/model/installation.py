"""What is known of an rorg that is installed on a machine: facts, as they were found once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.model.engines import DEFAULT_ENGINE


@dataclass(frozen=True, slots=True)
class Space:
    """Of one file system."""

    path: str
    free: int
    """Bytes that may still be written."""
    total: int
    files: int = 0
    """Files that may still be made; 0 where it does not count them."""


@dataclass(frozen=True, slots=True)
class Installation:
    """An empty text means that nothing is wrong, or that nothing is known, as is said of each."""

    engine: str = DEFAULT_ENGINE
    engine_host: str = ""
    engine_error: str = ""
    """Why it does not answer; empty where it does."""
    engine_denied: bool = False
    """It is there, and this user may not use it."""
    engine_version: str = ""
    live_restore: bool = True
    cgroup: int = 2
    pressure: bool = True
    """The kernel tells for how long programs wait (PSI)."""
    state_dir: str = ""
    state_error: str = ""
    """Why it cannot be used."""
    running: int = 0
    """Process id of the rorg that owns it; 0 for none."""
    socket: str = ""
    socket_error: str = ""
    """Why the running rorg does not answer this user."""
    answers: bool = False
    """The running rorg answers at its socket."""
    journal_error: str = ""
    """What is wrong with the file of the history."""
    git_version: str = ""
    """Empty where there is none."""
    git_refusal: str = ""
    """Why git says nothing of the manifests, though they lie in a repository."""
    clock_synchronized: bool | None = True
    """None where the kernel does not say."""
    spaces: tuple[Space, ...] = ()
    open_files: int = 1024
    """Files that this user's programs may have open."""
    sysctls: Mapping[str, int] = field(default_factory=dict)
