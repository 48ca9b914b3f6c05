"""The `rorg` command: who reads its line, and where errors become messages and exit codes."""

from __future__ import annotations

import contextlib
import gc
import os
import sys
from typing import Any

from rorg.cli.commands import ALIASES, COMMANDS, command_of
from rorg.errors import Exit, RorgError

CLIENT_CODES = {
    "forbidden": Exit.REFUSED,
    "refused": Exit.REFUSED,
    "not-ready": Exit.NOT_READY,
    "unreachable": Exit.UNREACHABLE,
    "busy": Exit.UNREACHABLE,
    "too-many-requests": Exit.UNREACHABLE,
    "internal": Exit.INTERNAL,
}
"""What the API answers, as exit codes."""


def __getattr__(name: str) -> Any:
    """`app` is the whole command line for typer, which is imported where it is needed."""
    if name == "app":
        from rorg.cli.app import app

        return app
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def run() -> None:
    """Entry point. An uncaught exception is a bug and exits 70, never 1, which means differences."""
    try:
        (_complete if "_RORG_COMPLETE" in os.environ else _command)(sys.argv[1:])
    except RorgError as error:
        _complain("\n".join([f"rorg: {error}", *getattr(error, "__notes__", ())]))
        sys.exit(int(error.code))
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        from rorg.cli.output import nobody_reads

        nobody_reads()
    except Exception as bug:
        _told_by_the_api(bug)
        if os.environ.get("RORG_TRACEBACK"):
            raise
        _complain(
            f"rorg: internal error: {type(bug).__name__}: {bug}\n"
            "This is a bug; RORG_TRACEBACK=1 shows where. Nothing more was changed."
        )
        sys.exit(int(Exit.INTERNAL))
    finally:
        gc.freeze()  # the interpreter's last searches for garbage cost a tenth of a short command, and find nothing


def _command(words: list[str]) -> None:
    """Runs what the line says: read here where it is plain, else by typer."""
    if words and words[0] in (*COMMANDS, *ALIASES):
        from rorg.cli import plain, signature

        command = command_of(words[0])
        values = plain.read(signature.parameters(command), words[1:], os.environ)
        if values is not None:
            signature.call(command, values)
            return
    elif words and not words[0].startswith("-"):
        from rorg.cli.usage import unknown_command

        raise unknown_command(words[0])
    from rorg.cli.app import run_typed

    run_typed(words)


def _complete(words: list[str]) -> None:
    """Says to a shell what may stand for the last word of a line."""
    from rorg.cli.completing import answer

    print(answer(os.environ["_RORG_COMPLETE"], words))


def _complain(text: str) -> None:
    """Says it, if anybody still listens; the exit code tells it anyway."""
    from rorg.cli.terminal import lines

    with contextlib.suppress(OSError):
        print(lines(text), file=sys.stderr, flush=True)


def _told_by_the_api(error: Exception) -> None:
    """Ends with the message of an error that the running rorg answered. The client is only looked for where a command
    has imported it: that costs 20 ms."""
    client = sys.modules.get("rorg_client")
    if client and isinstance(error, client.Error):
        from rorg.cli.terminal import entry

        _complain("\n".join([entry("rorg: ", error), *getattr(error, "__notes__", ())]))
        sys.exit(int(CLIENT_CODES.get(error.code, Exit.USAGE)))
