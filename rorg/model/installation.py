"""Facts about an installed rorg and its machine, gathered once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.model.engines import DEFAULT_ENGINE


@dataclass(frozen=True, slots=True)
class Space:
    """Free space of one file system."""

    path: str
    free: int
    """Free bytes."""
    total: int
    files: int = 0
    """Free inodes; 0 if the file system does not count them."""


@dataclass(frozen=True, slots=True)
class Installation:
    """The facts. In the `_error` fields, empty means no problem."""

    engine: str = DEFAULT_ENGINE
    engine_host: str = ""
    engine_error: str = ""
    """Why the engine does not answer; empty if it does."""
    engine_denied: bool = False
    """The engine runs, but this user may not use it."""
    engine_product: str = "Docker"
    engine_version: str = ""
    engine_lacks: Mapping[str, str] = field(default_factory=dict)
    """Option of a container -> what the engine does with it instead, and why."""
    live_restore: bool = True
    cgroup: int = 2
    pressure: bool = True
    """The kernel reports how long programs wait (PSI)."""
    state_dir: str = ""
    state_error: str = ""
    """Why the state directory cannot be used."""
    running: int = 0
    """Process id of the rorg that owns the state directory; 0 for none."""
    socket: str = ""
    socket_error: str = ""
    """Why the running rorg does not answer this user."""
    answers: bool = False
    """The running rorg answers at its socket."""
    unremoved: tuple[str, ...] = ()
    """What the engine does not remove, as the running rorg reports it: the service with the reason."""
    journal_error: str = ""
    """A problem with the journal; empty if there is none."""
    journal_damaged: tuple[str, ...] = ()
    """Files of earlier journals that were damaged, which rorg keeps."""
    git_version: str = ""
    """Empty if git is not installed."""
    git_refusal: str = ""
    """Why git refuses to read the manifests, although they are in a repository."""
    clock_synchronized: bool | None = True
    """None if the kernel does not report it."""
    spaces: tuple[Space, ...] = ()
    open_files: int = 1024
    """Maximum number of open files of this user's programs."""
    sysctls: Mapping[str, int] = field(default_factory=dict)
