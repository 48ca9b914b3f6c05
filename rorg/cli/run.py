"""rorg run"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rorg_client import Error

from rorg.cli.context import Context
from rorg.cli.kinds import DIRECTORY, DIRECTORY_NAME, FILE, Seconds, durations
from rorg.cli.listening import Files, files_of_machine, listening
from rorg.cli.options import RunTree
from rorg.cli.output import note
from rorg.cli.terminal import entry
from rorg.errors import Invalid
from rorg.model.machines import PORT
from rorg.model.units import counted
from rorg.store.state_dir import SERVER

if TYPE_CHECKING:
    from rorg.api.server import Server
    from rorg.api.tls import Tls
    from rorg.daemon.loop import Loop
    from rorg.host.git_cache import Followed

GROUP = "rorg"
"""The default, if there is a group of that name."""
STAY_DOWN = "RORG_STAY_DOWN"
"""The variable by which a supervisor that restarts rorg says that no person does."""
LOOK = b"l"
"""What the handler of SIGHUP writes into the pipe."""
Pem = Annotated[Path | None, typer.Option(help="PEM file, for --listen.")]
Group = Annotated[
    str,
    typer.Option(
        help="Members of this group (name or number) may do everything through the socket.", envvar="RORG_GROUP"
    ),
]
Listen = Annotated[
    str,
    typer.Option(
        help="Also serve the API on TCP, with TLS and only for clients with a certificate.", metavar="HOST:PORT"
    ),
]
Machine = Annotated[
    str,
    typer.Option(
        help="Which of the robot's machines this is. Default: RORG_MACHINE, or the one that it was last, or the one "
        "with the name of this computer.",
        metavar="NAME",
    ),
]
Certificates = Annotated[
    Path | None,
    typer.Option(
        help=f"For --listen, on port {PORT} by default: the files that `rorg certificate` has made for this machine.",
        metavar="DIR",
        click_type=DIRECTORY,
    ),
]
Git = Annotated[
    str,
    typer.Option(
        help="Follow the manifests of this repository instead of a directory.",
        metavar="REPO[@BRANCH]",
        click_type=DIRECTORY_NAME,
    ),
]
Signers = Annotated[
    Path | None,
    typer.Option(
        help="Accept only signed commits: a file of allowed ssh signers, or a GnuPG home.",
        metavar="FILE|DIR",
        click_type=FILE,
    ),
]
TlsRevoked = Annotated[Path | None, typer.Option(help="PEM list (CRL) of revoked client certificates, for --listen.")]
Top = Annotated[
    str, typer.Option(help="Directory of the manifests in the repository. Default: its top.", metavar="DIR")
]


def command(
    context: RunTree,
    *,
    machine: Machine = "",
    certificates: Certificates = None,
    group: Group = GROUP,
    listen: Listen = "",
    tls_cert: Pem = None,
    tls_key: Pem = None,
    tls_ca: Pem = None,
    tls_revoked: TlsRevoked = None,
    git: Git = "",
    path: Top = "",
    poll: Annotated[float, typer.Option(help="How often to fetch: 30s, 5m.", parser=durations(1, 86400))] = Seconds(30),
    committed: Annotated[bool, typer.Option("--committed", help="Use only committed manifests of DIRECTORY.")] = False,
    signers: Signers = None,
    ui: Annotated[bool, typer.Option("--ui", help="Also serve the page of `rorg ui`, and print its address.")] = False,
) -> None:
    """Run the loop until stopped: keep the containers as manifests and requests say, and serve the API.

    Example: rorg run manifests
    """
    from rorg.host.heap import share_heap
    from rorg.model.machines import MACHINE

    share_heap()
    if machine:
        os.environ[MACHINE] = machine
    if not git and _brought_up(context):
        return
    directory = context.directory or (context.root if committed else None)
    repository = followed(directory, git, path, committed, signers)
    _check(None if repository else context.root, group)
    files: Files = (tls_cert, tls_key, tls_ca, tls_revoked)
    if certificates:
        listen, files = listen or f"0.0.0.0:{PORT}", files_of_machine(certificates, machine)
    tcp = listening(listen, files) if listen else None
    context.state.acquire(SERVER)
    _tell_down(context)
    _serve(context, _loop(context, repository, poll), group, tcp, ui)


def _serve(context: Context, loop: Loop, group: str, tcp: tuple[str, int, Tls] | None, ui: bool) -> None:
    """Runs the loop and the API until it is told to stop, or the robot is down."""
    from rorg.api.links import Links
    from rorg.api.server import make_server
    from rorg.cli.ui import beside
    from rorg.store.clear import clear

    server = make_server(loop, context.state, group)
    server.tcp = tcp
    links = Links(loop.machines, tcp[2]) if tcp else None
    with context.state.usable():
        server.start()
    note(f"API on {server.directory / 'rorg.sock'}")
    if links:
        links.start()
    with beside(server.directory / "rorg.sock") if ui else nullcontext():
        _run_until_told(loop, server)
    if links:
        links.stop()
    if loop.is_down:
        clear(context.state, loop.wall())
        note("the robot is down; `rorg up` brings it up")
    context.state.release()
    if loop.hung:
        note(f"{counted(loop.hung, 'unfinished call')} to the engine or of probes: the next rorg sees the outcome")
        sys.stderr.flush()
        os._exit(0)  # the interpreter would wait for their threads


def _restarted() -> bool:
    """Whether systemd or an engine runs this rather than a person: then a robot that is down stays down."""
    return bool(os.environ.get(STAY_DOWN) or os.environ.get("NOTIFY_SOCKET"))


def _brought_up(context: Context) -> bool:
    """Whether an rorg already runs here whose robot is down: then that rorg brings it up. It keeps its tree, so this is
    not done for a different directory."""
    client = context.client()
    if client is None:
        return False
    try:
        view, asked = client.status(), context.directory
        if view.get("down") != "down" or (asked and str(asked.resolve()) != view["tree"]["root"]):
            return False
        client.call("DELETE", "/v1/down")
    except Error:  # acquire() reports who owns the directory
        return False
    note(f"the running rorg (pid {view['pid']}) is starting the robot")
    return True


def _tell_down(context: Context) -> None:
    """Notes that the robot stays down; if a person runs rorg, it may come up from now on."""
    from rorg.store.clear import stays_down

    if since := stays_down(context.state, _restarted()):
        note(f"the robot was taken down at {since}, and stays down; `rorg up` brings it up")


def _loop(context: Context, repository: Followed | None, poll: float) -> Loop:
    """The loop over a directory of manifests, or over a repository. Raises Invalid if the directory has no robot of the
    given name; in a repository that is an error of its manifests."""
    from rorg.daemon.wiring import make_loop, make_source

    robot = context.asked_robot if repository else context.named_robot
    source = make_source(context.state, repository, poll) if repository else None
    root = source.root if source else context.root.resolve()
    loop = make_loop(
        root,
        context.state,
        context.engine(),
        lambda line: note(entry(f"{time.strftime('%H:%M:%S')} ", line)),
        robot,
        source,
    )
    what = (repository.shown if repository else str(root)) + (f" for {loop.tree.robot}" if loop.tree.robot else "")
    note(
        f"rorg runs {what} on {context.engine_name}, state in {context.state.path}; "
        "containers keep running when it stops"
    )
    return loop


def _check(root: Path | None, group: str) -> None:
    """Raises Invalid if the directory, or a given group, does not exist."""
    from rorg.api.permissions import group_id

    if root is not None and not root.is_dir():
        raise Invalid(f"run {root}", "no such directory", "the directory that holds services/")
    if group_id(group) is None and group != GROUP:
        raise Invalid(f"let the group '{group}' in", "no such group", f"`sudo groupadd --system {group}`")


def _run_until_told(loop: Loop, server: Server) -> None:
    """Runs until SIGINT or SIGTERM. SIGHUP makes rorg fetch its repository and read its manifests again. systemd is
    notified when rorg is ready, when it stops, and regularly that it is alive."""
    from rorg.host.systemd import Watchdog, notify

    told, tell = os.pipe()

    def end() -> None:
        while os.read(told, 1) == LOOK:
            if loop.tree.source is not None:
                loop.tree.source.ask()
            loop.wakes.files_changed()
        server.end()
        loop.stop()

    # A signal handler must not take a lock: the interrupted loop may hold it.
    threading.Thread(target=end, name="signals", daemon=True).start()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os.write(tell, b"."))
    signal.signal(signal.SIGHUP, lambda *_: os.write(tell, LOOK))
    watchdog = Watchdog(loop.wake, lambda: loop.passes)
    watchdog.start()
    notify("READY=1")
    try:
        loop.run()
    finally:
        notify("STOPPING=1")
        watchdog.stop()
        server.stop()


def followed(directory: Path | None, git: str, path: str, committed: bool, signers: Path | None) -> Followed | None:
    """None where a directory is followed as it is. Raises Invalid."""
    from rorg.host.git_cache import Followed
    from rorg.host.git_remote import remote, without_user

    if not (git or committed):
        for option, given in (("--path", path), ("--signers", signers)):
            if given:
                raise Invalid(f"use {option}", "no repository is followed", "--git REPO, or --committed, with it")
        return None
    if git and (directory or committed):
        other = "DIRECTORY" if directory else "--committed"
        raise Invalid(f"follow {without_user(git)} and {other}", "they are mutually exclusive", "`rorg run --help`")
    if signers and not signers.exists():
        raise Invalid(f"verify by {signers}", "no such file or directory", "a file of ssh signers, or a GnuPG home")
    trusted = signers.resolve() if signers else None
    if committed:
        return _own(directory or Path("manifests"), path, trusted)
    try:
        return Followed(remote(git), _inner(path), trusted)
    except ValueError as error:
        raise Invalid(f"follow {without_user(git)}", str(error), "REPO or REPO@BRANCH") from error


def _own(directory: Path, path: str, signers: Path | None) -> Followed:
    """The repository that a directory is in, wherever it is at."""
    from rorg.host.git_cache import Followed
    from rorg.host.git_process import git_command, repository
    from rorg.host.git_remote import Remote

    git_path = repository(directory)
    if git_path is None or not directory.is_dir():
        why = "it is not in a git repository" if directory.is_dir() else "no such directory"
        remedy = f"`{git_command('/', 'init', os.path.abspath(directory))}` and a commit, or no --committed"
        raise Invalid(f"follow the commits of {directory}", why, remedy)
    top = git_path.parent
    return Followed(Remote(str(top)), str(directory.resolve().relative_to(top) / _inner(path)), signers, forward=False)


def _inner(path: str) -> str:
    """A directory of a repository. Raises Invalid."""
    if path.startswith("/") or ".." in Path(path).parts:
        raise Invalid(f"read manifests in {path}", "it is not inside the repository", "--path DIR, from its top")
    return str(Path(path))
