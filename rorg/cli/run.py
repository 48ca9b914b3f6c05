"""rorg run"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rorg.cli.options import DIRECTORIES, FILES, Directory, EngineName, Option, OwnStateDirectory, duration

if TYPE_CHECKING:
    from rorg.api.server import Server
    from rorg.api.tls import Tls
    from rorg.cli.context import Context
    from rorg.daemon.loop import Loop
    from rorg.host.git_cache import Followed

GROUP = "rorg"
"""By default, where there is one of that name."""
STAY_DOWN = "RORG_STAY_DOWN"
"""The variable by which whatever restarts rorg says that no person does."""
LOOK = b"l"
"""What the handler of SIGHUP writes."""
Pem = Annotated[Path | None, Option(names=(), show_default=False, help="PEM file, for --listen.")]


def command(
    directory: Directory = None,
    state_dir: OwnStateDirectory = None,
    engine: EngineName = None,
    group: Annotated[
        str,
        Option(
            names=("--group",),
            envvar="RORG_GROUP",
            help="Members of this group (name or number) may do everything through the socket.",
        ),
    ] = GROUP,
    listen: Annotated[
        str,
        Option(
            names=("--listen",),
            metavar="HOST:PORT",
            show_default=False,
            help=("Also serve the API on TCP, with TLS and only for clients with a certificate."),
        ),
    ] = "",
    tls_cert: Pem = None,
    tls_key: Pem = None,
    tls_ca: Pem = None,
    tls_revoked: Annotated[
        Path | None,
        Option(names=(), show_default=False, help="PEM list (CRL) of revoked client certificates, for --listen."),
    ] = None,
    git: Annotated[
        str,
        Option(
            names=("--git",),
            metavar="REPO[@BRANCH]",
            show_default=False,
            completes=DIRECTORIES,
            help="Follow the manifests of this repository instead of a directory.",
        ),
    ] = "",
    path: Annotated[
        str,
        Option(
            names=("--path",),
            metavar="DIR",
            show_default=False,
            help="Directory of the manifests in the repository. Default: its top.",
        ),
    ] = "",
    poll: Annotated[
        float,
        Option(
            names=("--poll",),
            parser=duration,
            metavar="DURATION",
            least=1,
            most=86_400,
            help="How often to fetch: 30s, 5m.",
        ),
    ] = 30.0,
    committed: Annotated[
        bool, Option(names=("--committed",), help="Use only committed manifests of DIRECTORY.")
    ] = False,
    signers: Annotated[
        Path | None,
        Option(
            names=("--signers",),
            metavar="FILE|DIR",
            show_default=False,
            completes=FILES,
            help="Accept only signed commits: a file of allowed ssh signers, or a GnuPG home.",
        ),
    ] = None,
) -> None:
    """Run the loop until stopped: keep the containers as manifests and requests say, and serve the API.

    Example: rorg run manifests
    """
    from rorg.api.server import make_server
    from rorg.cli.context import Context
    from rorg.cli.following import followed
    from rorg.cli.output import note
    from rorg.host.heap import share_heap
    from rorg.store.clear import clear

    share_heap()
    context = Context(state_dir, engine, directory, local=True, own=True)
    if not git and _brought_up(context):
        return
    repository = followed(context.directory or context.root if committed else directory, git, path, committed, signers)
    _check(None if repository else context.root, group)
    tcp = _tcp(listen, (tls_cert, tls_key, tls_ca, tls_revoked)) if listen else None
    context.state.acquire("rorg run")
    _tell_down(context)
    loop = _loop(context, repository, poll)
    server = make_server(loop, context.state, group)
    server.tcp = tcp
    with context.state.usable():
        server.start()
    note(f"API on {server.directory / 'rorg.sock'}")
    _run_until_told(loop, server)
    if loop.is_down:
        clear(context.state, loop.wall())
        note("the robot is down; `rorg up` brings it up")
    context.state.release()
    if loop.hung:
        import sys

        from rorg.model.units import counted

        note(f"{counted(loop.hung, 'unfinished call')} to the engine or of probes: the next rorg sees the outcome")
        sys.stderr.flush()
        os._exit(0)  # the interpreter would wait for their threads


def _restarted() -> bool:
    """Whether systemd or an engine runs this, rather than a person: a robot that is down stays down then."""
    return bool(os.environ.get(STAY_DOWN) or os.environ.get("NOTIFY_SOCKET"))


def _brought_up(context: Context) -> bool:
    """Whether an rorg runs here whose robot is down: that rorg brings it up. Only a person starts a second rorg. The
    first one keeps its tree, so this is for those who name no other one."""
    from rorg_client import Error

    from rorg.cli.output import note

    client = context.client()
    if client is None:
        return False
    try:
        view, asked = client.status(), context.directory
        if view.get("down") != "down" or (asked and str(asked.resolve()) != view["tree"]["root"]):
            return False
        client.call("DELETE", "/v1/down")
    except Error:  # whoever owns the directory is told by acquire()
        return False
    note(f"the robot comes up; rorg run (pid {view['pid']}) sees to it")
    return True


def _tell_down(context: Context) -> None:
    """Says it if the robot stays down; if it was a person who runs rorg, the robot may come up from here on."""
    from rorg.cli.output import note
    from rorg.store.clear import stays_down

    if since := stays_down(context.state, _restarted()):
        note(f"the robot was taken down at {since}, and stays down; `rorg up` brings it up")


def _loop(context: Context, repository: Followed | None, poll: float) -> Loop:
    """Over the directory of manifests, or over a repository; told in one line. Raises Invalid where the directory has
    no robot of the name that was asked for; of a repository that is an error of its manifests."""
    import time

    from rorg.cli.output import note
    from rorg.cli.terminal import entry
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
    """Raises Invalid where a directory, or a group that was named, is not there."""
    from rorg.api.permissions import group_id
    from rorg.errors import Invalid

    if root is not None and not root.is_dir():
        raise Invalid(f"run {root}", "no such directory", "the directory that holds services/")
    if group_id(group) is None and group != GROUP:
        raise Invalid(f"let the group '{group}' in", "no such group", f"`sudo groupadd --system {group}`")


def _run_until_told(loop: Loop, server: Server) -> None:
    """Until SIGINT or SIGTERM. At SIGHUP it looks at its manifests again, first of all at the repository that it
    follows. systemd hears when it begins to work, when it ends, and that it goes on."""
    import signal
    import threading

    from rorg.host.systemd import Watchdog, notify

    told, tell = os.pipe()

    def end() -> None:
        while os.read(told, 1) == LOOK:
            if loop.tree.source is not None:
                loop.tree.source.ask()
            loop.wakes.files_changed()
        server.end()
        loop.stop()

    # A handler must not take a lock: it interrupts the loop, which may be holding that very one.
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


def _tcp(listen: str, files: tuple[Path | None, ...]) -> tuple[str, int, Tls]:
    """Where to listen and how to know clients. Raises Invalid without the files that this takes."""
    from rorg.api.tls import Tls, TlsFiles
    from rorg.errors import Invalid

    host, _, port = listen.rpartition(":")
    cert, key, authority, revoked = files
    if not (cert and key and authority and port.isdigit()):
        raise Invalid(
            f"listen on {listen}",
            "TCP is only served with TLS and client certificates",
            "HOST:PORT with --tls-cert, --tls-key and --tls-ca",
        )
    return host or "127.0.0.1", int(port), Tls(TlsFiles(cert, key, authority, revoked))
