"""rorg help"""

from __future__ import annotations

from typing import Annotated

import typer

from rorg.cli.names import complete_commands

SHARED = "options"


def command(
    ctx: typer.Context,
    topic: Annotated[
        str,
        typer.Argument(
            help="A command, or `options`: those that most commands have.", autocompletion=complete_commands
        ),
    ] = "",
) -> None:
    """Show the help of rorg, of a command, or of the options that most commands have.

    Example: rorg help options
    """
    from rorg.cli.app import RORG, parts, typer_command

    if topic != SHARED:
        with RORG.make_context("rorg", [topic, "--help"] if topic else ["--help"]) as root:
            RORG.invoke(root)
    formatter = ctx.make_formatter()
    formatter.write_text("Most commands have these options:")
    with formatter.section("Options"):
        formatter.write_dl(parts(typer_command("get"), ctx)[2])  # it has all of them
    print(formatter.getvalue(), end="")
