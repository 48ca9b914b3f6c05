"""What is wrong with an installation, and what to do: from facts alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from rorg.model.engines import capabilities_of
from rorg.model.installation import Installation, Space
from rorg.model.units import format_memory

OK, WARNING, ERROR = "ok", "warning", "error"
LITTLE, TOO_LITTLE = 2 << 30, 200 << 20
"""Bytes of a disk: below the first an image may not fit, below the second the history may not."""
FEW_FILES = 10_000
WATCHES, INSTANCES = 16_384, 64
"""inotify: a tree of manifests with what it mounts takes some thousand watches, and other programs need theirs."""
OPEN_FILES = 1024


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was looked at."""

    name: str
    status: str
    """ok, warning or error: with an error rorg cannot do its work."""
    message: str
    remedy: str = ""

    def as_json(self) -> dict[str, str]:
        return {"check": self.name, "status": self.status, "message": self.message, "remedy": self.remedy}


def examine(found: Installation) -> list[Check]:
    """All checks, in an order in which one may be the cause of those after it."""
    return [check for look in _LOOKS for check in look(found)]


def _engine(found: Installation) -> Iterator[Check]:
    if not capabilities_of(found.engine).server:
        yield Check("engine", OK, f"{found.engine}: needs nothing else")
    elif found.engine_denied:
        message = f"you may not use the engine at {found.engine_host}"
        yield Check("engine", ERROR, message, "`sudo usermod -aG docker $USER` and log in again, or as root")
    elif found.engine_error:
        message = f"the engine at {found.engine_host} does not answer: {found.engine_error}"
        yield Check("engine", ERROR, message, "`systemctl start docker`, DOCKER_HOST, or --engine process")
    else:
        yield Check("engine", OK, f"Docker {found.engine_version} answers at {found.engine_host}")
        if not found.live_restore:
            message = "containers end when the engine itself is started again"
            remedy = '{"live-restore": true} in /etc/docker/daemon.json'
            yield Check("live-restore", WARNING, message, remedy)


def _kernel(found: Installation) -> Iterator[Check]:
    yield Check("cgroup", OK, f"control groups of version {found.cgroup}")
    if found.pressure:
        yield Check("pressure", OK, "the kernel tells how long programs wait (PSI)")
    else:
        message = "the kernel does not tell how long programs wait (PSI): the Policy's `pressure` sees load alone"
        yield Check("pressure", WARNING, message, "psi=1 on the kernel's command line")


def _state(found: Installation) -> Iterator[Check]:
    if found.state_error:
        message = f"{found.state_dir} cannot be used: {found.state_error}"
        yield Check("state-directory", ERROR, message, "as root, --state-dir DIR, or RORG_STATE_DIR")
    else:
        yield Check("state-directory", OK, found.state_dir)
    if found.journal_error:
        message = f"the history cannot be read: {found.journal_error}"
        yield Check("journal", ERROR, message, "starting rorg again, which moves it aside and begins a new one")
    else:
        yield Check("journal", OK, "the history can be read")


def _server(found: Installation) -> Iterator[Check]:
    if found.socket_error:
        yield Check("rorg", ERROR, f"{found.socket}: {found.socket_error}", "the group of that socket, or as root")
    elif found.answers:
        yield Check("rorg", OK, f"rorg answers at {found.socket}")
    elif found.running:
        message = f"rorg runs (process {found.running}) and does not answer at {found.socket}"
        yield Check("rorg", ERROR, message, "`journalctl -u rorg`, and starting it again")
    else:
        yield Check("rorg", WARNING, "no rorg runs here", "`rorg run`, or `systemctl start rorg`")


def _git(found: Installation) -> Iterator[Check]:
    if not found.git_version:
        yield Check("git", WARNING, "no git: no revisions, and nothing to go back to", "installing git")
    elif found.git_refusal:
        message, _, remedy = found.git_refusal.partition("; try ")
        yield Check("git", WARNING, message, remedy)
    else:
        yield Check("git", OK, found.git_version)


def _clock(found: Installation) -> Iterator[Check]:
    if found.clock_synchronized:
        yield Check("clock", OK, "it is synchronized")
    elif found.clock_synchronized is None:
        yield Check("clock", OK, "the kernel does not say whether it is synchronized")
    else:
        message = "it is not synchronized: times of several machines, and of ROS messages, cannot be compared"
        yield Check("clock", WARNING, message, "`timedatectl set-ntp true`, or chrony")


def _disks(found: Installation) -> Iterator[Check]:
    for space in found.spaces:
        name, shown = f"disk {space.path}", f"{format_memory(space.free)} of {format_memory(space.total)} are free"
        short = space.free < TOO_LITTLE
        if short or space.free < LITTLE or _no_files(space):
            what = shown if not _no_files(space) else f"{space.files} files can be made yet"
            yield Check(name, ERROR if short else WARNING, what, "`rorg image prune`, `docker system df`, older bags")
        else:
            yield Check(name, OK, shown)


def _no_files(space: Space) -> bool:
    return 0 < space.files < FEW_FILES


def _limits(found: Installation) -> Iterator[Check]:
    for name, least in (("fs.inotify.max_user_watches", WATCHES), ("fs.inotify.max_user_instances", INSTANCES)):
        value = found.sysctls.get(name)
        if value is not None and value < least:
            message = f"{name} is {value}: changes of files may be seen late"
            yield Check("inotify", WARNING, message, f"`sysctl -w {name}={least * 4}`, and a file in /etc/sysctl.d")
            return
    yield Check("inotify", OK, "files can be watched")
    if found.open_files < OPEN_FILES:
        message = f"{found.open_files} files may be open: many services need more"
        yield Check("open-files", WARNING, message, "`ulimit -n 65536`, or LimitNOFILE= of the unit")


_LOOKS: tuple[Callable[[Installation], Iterator[Check]], ...] = (
    _engine,
    _kernel,
    _state,
    _server,
    _git,
    _clock,
    _disks,
    _limits,
)
