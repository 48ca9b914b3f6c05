"""rorg run"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rorg.cli.options import Directory, EngineName, Option, OwnStateDirectory

if TYPE_CHECKING:
    from rorg.api.server import Server
    from rorg.cli.context import Context
    from rorg.daemon.loop import Loop

GROUP = "rorg"
"""By default, where there is one of that name."""
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
            help="Members of this group, by name or number, may do everything through the socket.",
        ),
    ] = GROUP,
    listen: Annotated[
        str,
        Option(
            names=("--listen",),
            metavar="HOST:PORT",
            show_default=False,
            help=("Serve the API on TCP too; only with TLS, and for clients with a certificate."),
        ),
    ] = "",
    tls_cert: Pem = None,
    tls_key: Pem = None,
    tls_ca: Pem = None,
) -> None:
    """Run the loop: keep the containers as the manifests and the requests file say, until stopped. Serves the API.

    Example: rorg run manifests
    """
    import time

    from rorg.api.server import make_server
    from rorg.cli.context import Context
    from rorg.cli.output import note
    from rorg.cli.terminal import entry
    from rorg.daemon.wiring import make_loop
    from rorg.store.clearing import clear

    context = Context(state_dir, engine, directory, local=True, own=True)
    robot = _check(context, group)
    tcp = _tcp(listen, tls_cert, tls_key, tls_ca) if listen else None
    context.state.acquire("rorg run")
    loop = make_loop(
        context.root,
        context.state,
        context.engine(),
        lambda line: note(entry(f"{time.strftime('%H:%M:%S')} ", line)),
        robot,
    )
    note(_begins(context, loop))
    server = make_server(loop, context.state, group)
    server.tcp = tcp
    with context.state.usable():
        server.start()
    note(f"API on {server.directory / 'rorg.sock'}")
    _run_until_told(loop, server)
    if loop.is_down:
        clear(context.state)
        note("the robot is down; only its manifests are left")
    context.state.release()
    if loop.hung:
        import os
        import sys

        from rorg.model.units import counted

        note(f"{counted(loop.hung, 'unfinished call')} to the engine or of probes: the next rorg sees the outcome")
        sys.stderr.flush()
        os._exit(0)  # the interpreter would wait for their threads


def _begins(context: Context, loop: Loop) -> str:
    """What runs where."""
    whose = f" for {loop.tree.robot}" if loop.tree.robot else ""
    where = f"{context.root.resolve()}{whose} on {context.engine_name}, state in {context.state.path}"
    return f"rorg runs {where}; containers keep running when it stops"


def _check(context: Context, group: str) -> str:
    """The robot that was named. Raises Invalid where the directory, that robot or that group is not there."""
    from rorg.api.permissions import group_id
    from rorg.errors import Invalid

    if not context.root.is_dir():
        raise Invalid(f"run {context.root}", "no such directory", "the directory that holds services/")
    if group_id(group) is None and group != GROUP:
        raise Invalid(f"let the group '{group}' in", "no such group", f"`sudo groupadd --system {group}`")
    return context.named_robot


def _run_until_told(loop: Loop, server: Server) -> None:
    """Until SIGINT or SIGTERM. systemd hears when it begins to work, when it ends, and that it goes on."""
    import os
    import signal
    import threading

    from rorg.host.systemd import Watchdog, notify

    told, tell = os.pipe()

    def end() -> None:
        os.read(told, 1)
        server.end()
        loop.stop()

    # A handler must not take a lock: it interrupts the loop, which may be holding that very one.
    threading.Thread(target=end, name="signals", daemon=True).start()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os.write(tell, b"."))
    watchdog = Watchdog(loop.wake, lambda: loop.passes)
    watchdog.start()
    notify("READY=1")
    try:
        loop.run()
    finally:
        notify("STOPPING=1")
        watchdog.stop()
        server.stop()


def _tcp(listen: str, cert: Path | None, key: Path | None, authority: Path | None) -> tuple[str, int, Any]:
    """Where to listen and how to know clients. Raises Invalid without all three files."""
    import ssl

    from rorg.errors import Invalid

    host, _, port = listen.rpartition(":")
    if not (cert and key and authority and port.isdigit()):
        raise Invalid(
            f"listen on {listen}",
            "TCP is only served with TLS and client certificates",
            "HOST:PORT with --tls-cert, --tls-key and --tls-ca",
        )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(cert, key)
        context.load_verify_locations(authority)
    except (OSError, ssl.SSLError) as error:
        raise Invalid(f"listen on {listen}", f"the certificates cannot be read: {error}") from error
    context.verify_mode = ssl.CERT_REQUIRED
    return host or "127.0.0.1", int(port), context
