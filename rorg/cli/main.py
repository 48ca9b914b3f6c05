"""The `rorg` command: runs a line, and turns errors into messages and exit codes."""

from __future__ import annotations

import contextlib
import gc
import os
import sys

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
        _not_sent(bug)
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
    """Runs a line. Not by typer's own main(), which turns a closed output and Ctrl-C into exit codes of its own."""
    import typer
    from typer._click.exceptions import UsageError

    from rorg.cli.app import RORG
    from rorg.cli.mistakes import misread

    try:
        with RORG.make_context("rorg", ["--version"] if words == ["version"] else words) as ctx:
            RORG.invoke(ctx)
    except UsageError as error:
        raise misread(error) from error
    except typer.Exit as end:
        sys.exit(end.exit_code)


def _complete(words: list[str]) -> None:
    """Prints the completions of the last word of a line, for a shell."""
    from rorg.cli.completion import answer

    print(answer(os.environ["_RORG_COMPLETE"], words))


def _not_sent(bug: Exception) -> None:
    """Exits if an argument is not UTF-8, as rorg's API and files are. A shell hands on any bytes."""
    if isinstance(bug, UnicodeEncodeError) and bug.encoding == "utf-8":
        text = bug.object[bug.start : bug.end]
        _complain(f"rorg: cannot send {text!a}: it is not UTF-8; use other characters")
        sys.exit(int(Exit.USAGE))


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
