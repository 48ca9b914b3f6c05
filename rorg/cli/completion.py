"""rorg completion"""

from __future__ import annotations

from typing import Annotated

from rorg.cli.options import Argument
from rorg.cli.output import check_form, echo


def command(shell: Annotated[str, Argument(help="bash, zsh or fish.")]) -> None:
    """Print the completion script of a shell; for bash: source <(rorg completion bash)."""
    from typer.completion import get_completion_script  # type: ignore[attr-defined]

    check_form(shell, ("bash", "zsh", "fish"))
    echo(get_completion_script(prog_name="rorg", complete_var="_RORG_COMPLETE", shell=shell))
