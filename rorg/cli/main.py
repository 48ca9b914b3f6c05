"""The `rorg` command: its list of commands, and where errors become messages and exit codes."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys

import typer

from rorg.errors import Exit, RorgError

COMMANDS = (
    "validate",
    "diff",
    "apply",
    "run",
    "get",
    "describe",
    "why",
    "request",
    "release",
    "restart",
    "hold",
    "suspend",
    "wait",
    "events",
    "top",
    "logs",
    "graph",
    "build",
    "demo",
    "completion",
)

CLIENT_CODES = {
    "forbidden": Exit.REFUSED,
    "refused": Exit.REFUSED,
    "not-ready": Exit.NOT_READY,
    "unreachable": Exit.UNREACHABLE,
    "busy": Exit.UNREACHABLE,
    "internal": Exit.INTERNAL,
}
"""What the API answers, as exit codes."""

app = typer.Typer(
    name="rorg",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Run a robot's services: declared in YAML, started and ceased by requests.",
    epilog="Exit codes: 0 fine, 1 differences (diff), 2 usage or invalid manifest, 3 engine or daemon unreachable, "
    "4 applied but not ready, 5 refused, 70 internal error.",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(value: bool) -> None:
    if value:
        from rorg import __version__

        typer.echo(f"rorg {__version__}")
        raise typer.Exit()


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    pass


for _name in COMMANDS:
    _module = importlib.import_module(f"rorg.cli.{_name}")
    app.command(_name)(_module.command)


def run() -> None:
    """Entry point. An uncaught exception is a bug and exits 70, never 1, which means differences."""
    try:
        if "_RORG_COMPLETE" in os.environ:
            from typer.completion import completion_init  # type: ignore[attr-defined]

            completion_init()
        app()
    except RorgError as error:
        _complain(f"rorg: {error}")
        sys.exit(int(error.code))
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except Exception as bug:
        _told_by_the_api(bug)
        if os.environ.get("RORG_TRACEBACK"):
            raise
        _complain(
            f"rorg: internal error: {type(bug).__name__}: {bug}\n"
            "This is a bug; RORG_TRACEBACK=1 shows where. Nothing more was changed."
        )
        sys.exit(int(Exit.INTERNAL))


def _complain(text: str) -> None:
    """Says it, if anybody still listens; the exit code tells it anyway."""
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)


def _told_by_the_api(error: Exception) -> None:
    """Ends with the message of an error that the running rorg answered. The client is only looked for where a command
    has imported it: that costs 20 ms."""
    client = sys.modules.get("rorg_client")
    if client and isinstance(error, client.Error):
        _complain(f"rorg: {error}")
        sys.exit(int(CLIENT_CODES.get(error.code, Exit.USAGE)))
