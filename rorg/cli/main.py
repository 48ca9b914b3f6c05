"""The `rorg` command: runs a line, and turns errors into messages and exit codes."""

from __future__ import annotations

import contextlib
import gc
import os
import sys

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
"""Code of an API error -> exit code."""


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
        gc.freeze()  # the interpreter's last garbage collections take a tenth of a short command, and find nothing


def _command(words: list[str]) -> None:
    """Runs a line: `rorg help X` is `rorg X --help`."""
    name, *rest = words or ["help"]
    if name in ("--version", "version"):
        from rorg import __version__

        print(f"rorg {__version__}")
    elif name in ("-h", "--help") or (name == "help" and not rest):
        from rorg.cli.help import help_of_rorg

        print(help_of_rorg())
    elif name == "help":
        _command([rest[0], "--help"])
    elif name not in (*COMMANDS, *ALIASES):
        from rorg.cli.usage import unknown

        raise unknown(name)
    elif {"-h", "--help"} & set(rest[: rest.index("--")] if "--" in rest else rest):
        from rorg.cli.help import help_of

        print(help_of(name))
    else:
        from rorg.cli import command_line, signature

        command = command_of(name)
        signature.call(command, command_line.read(name, signature.parameters(command), rest, os.environ))


def _complete(words: list[str]) -> None:
    """Prints the completions of the last word of a line, for a shell."""
    from rorg.cli.completions import answer

    print(answer(os.environ["_RORG_COMPLETE"], words))


def _complain(text: str) -> None:
    """Prints an error if anyone reads it; the exit code says it anyway."""
    from rorg.cli.terminal import lines

    with contextlib.suppress(OSError):
        print(lines(text), file=sys.stderr, flush=True)


def _told_by_the_api(error: Exception) -> None:
    """Ends with the message of an error that the running rorg answered. Importing the client takes 20 ms, so it is only
    looked at if a command has imported it."""
    client = sys.modules.get("rorg_client")
    if client and isinstance(error, client.Error):
        from rorg.cli.terminal import entry

        _complain("\n".join([entry("rorg: ", error), *getattr(error, "__notes__", ())]))
        sys.exit(int(CLIENT_CODES.get(error.code, Exit.USAGE)))
