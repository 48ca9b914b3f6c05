"""`rorg doctor`: judge an installation from facts that were gathered before, and suggest a remedy for each problem."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from rorg.model.engines import capabilities_of
from rorg.model.installation import Installation, Space
from rorg.model.units import format_memory

OK, WARNING, ERROR = "ok", "warning", "error"
LITTLE, TOO_LITTLE = 2 << 30, 200 << 20
"""Bytes of free disk space: below the first an image may not fit, below the second the journal may not."""
FEW_FILES = 10_000
WATCHES, INSTANCES = 16_384, 64
"""inotify limits: a tree of manifests with the files it mounts takes some thousand watches, and other programs need
theirs."""
OPEN_FILES = 1024


@dataclass(frozen=True, slots=True)
class Check:
    """The result of one check."""

    name: str
    status: str
    """ok, warning or error. With an error rorg cannot do its work."""
    message: str
    remedy: str = ""

    def as_json(self) -> dict[str, str]:
        return {"check": self.name, "status": self.status, "message": self.message, "remedy": self.remedy}


def examine(host: Installation) -> list[Check]:
    """Run all checks, in an order in which one problem may cause those after it."""
    return [check for checks in _CHECKS for check in checks(host)]


def _engine(host: Installation) -> Iterator[Check]:
    if not capabilities_of(host.engine).server:
        yield Check("engine", OK, f"{host.engine}: needs nothing else")
    elif host.engine_denied:
        message = f"no permission to use the engine at {host.engine_host}"
        yield Check("engine", ERROR, message, "`sudo usermod -aG docker $USER` and log in again, or as root")
    elif host.engine_error:
        message = f"the engine at {host.engine_host} does not answer: {host.engine_error}"
        yield Check("engine", ERROR, message, "`systemctl start docker`, DOCKER_HOST, or --engine process")
    else:
        yield Check(
            "engine",
            OK,
            f"{' '.join(filter(None, (host.engine_product, host.engine_version)))} answers at {host.engine_host}",
        )
        for why in sorted(set(host.engine_lacks.values())):
            options = ", ".join(option for option, reason in host.engine_lacks.items() if reason == why)
            yield Check("engine-lacks", WARNING, f"{options}: {why}", "`rorg validate --machine` for the services")
        if not host.live_restore:
            message = "containers stop when the engine restarts"
            remedy = '{"live-restore": true} in /etc/docker/daemon.json'
            yield Check("live-restore", WARNING, message, remedy)


def _kernel(host: Installation) -> Iterator[Check]:
    yield Check("cgroup", OK, f"control groups v{host.cgroup}")
    if host.pressure:
        yield Check("pressure", OK, "the kernel reports pressure (PSI)")
    else:
        message = "the kernel reports no pressure (PSI): the Policy's `pressure` sees only load"
        yield Check("pressure", WARNING, message, "psi=1 on the kernel's command line")


def _state(host: Installation) -> Iterator[Check]:
    if host.state_error:
        message = f"{host.state_dir} cannot be used: {host.state_error}"
        yield Check("state-directory", ERROR, message, "as root, --state-dir DIR, or RORG_STATE_DIR")
    else:
        yield Check("state-directory", OK, host.state_dir)
    if host.journal_error:
        message = f"the history cannot be read: {host.journal_error}"
        yield Check("journal", ERROR, message, "`systemctl restart rorg`, which moves it aside and begins a new one")
    elif host.journal_damaged:
        message = f"the history was damaged and began again; the damaged one is {' and '.join(host.journal_damaged)}"
        remedy = "`sqlite3 FILE .recover` for what is left in it, then delete it"
        yield Check("journal", WARNING, message, remedy)
    else:
        yield Check("journal", OK, "the history can be read")


def _server(host: Installation) -> Iterator[Check]:
    if host.socket_error:
        yield Check("rorg", ERROR, f"{host.socket}: {host.socket_error}", "the group of that socket, or as root")
    elif host.answers:
        yield Check("rorg", OK, f"rorg answers at {host.socket}")
    elif host.running:
        message = f"rorg runs (process {host.running}) and does not answer at {host.socket}"
        yield Check("rorg", ERROR, message, "`journalctl -u rorg`, then `systemctl restart rorg`")
    else:
        yield Check("rorg", WARNING, "no rorg runs here", "`rorg run`, or `systemctl start rorg`")


def _removals(host: Installation) -> Iterator[Check]:
    for text in host.unremoved:
        yield Check("removal", WARNING, text, "the engine's log for what holds it, then a restart of the engine")


def _git(host: Installation) -> Iterator[Check]:
    if not host.git_version:
        yield Check("git", WARNING, "git is not installed: no revisions and no way back", "install git")
    elif host.git_refusal:
        message, _, remedy = host.git_refusal.partition("; try ")
        yield Check("git", WARNING, message, remedy)
    else:
        yield Check("git", OK, host.git_version)


def _clock(host: Installation) -> Iterator[Check]:
    if host.clock_synchronized:
        yield Check("clock", OK, "it is synchronized")
    elif host.clock_synchronized is None:
        yield Check("clock", OK, "the kernel does not say whether it is synchronized")
    else:
        message = "it is not synchronized: times of several machines, and of ROS messages, cannot be compared"
        yield Check("clock", WARNING, message, "`timedatectl set-ntp true`, or chrony")


def _disks(host: Installation) -> Iterator[Check]:
    for space in host.spaces:
        name, shown = f"disk {space.path}", f"{format_memory(space.free)} of {format_memory(space.total)}"
        remedy = "`rorg image prune`, `docker system df`, or delete old bags"
        if space.free < TOO_LITTLE:
            message = f"less than {format_memory(TOO_LITTLE)} are free, which the history may need: {shown}"
            yield Check(name, ERROR, message, remedy)
        elif _no_files(space):
            yield Check(name, WARNING, f"{space.files} more files can be created", remedy)
        elif space.free < LITTLE:
            message = f"less than {format_memory(LITTLE)} are free, which an image may need: {shown}"
            yield Check(name, WARNING, message, remedy)
        else:
            yield Check(name, OK, f"{shown} are free")


def _no_files(space: Space) -> bool:
    return 0 < space.files < FEW_FILES


def _limits(host: Installation) -> Iterator[Check]:
    for name, least in (("fs.inotify.max_user_watches", WATCHES), ("fs.inotify.max_user_instances", INSTANCES)):
        value = host.sysctls.get(name)
        if value is not None and value < least:
            message = f"{name} is {value}: changes of files may be seen late"
            yield Check("inotify", WARNING, message, f"`sysctl -w {name}={least * 4}`, and a file in /etc/sysctl.d")
            break
    else:
        yield Check("inotify", OK, "files can be watched")
    if host.open_files < OPEN_FILES:
        message = f"{host.open_files} open files are allowed: many services need more"
        yield Check("open-files", WARNING, message, "`ulimit -n 65536`, or LimitNOFILE= of the unit")


_CHECKS: tuple[Callable[[Installation], Iterator[Check]], ...] = (
    _engine,
    _kernel,
    _state,
    _server,
    _removals,
    _git,
    _clock,
    _disks,
    _limits,
)
