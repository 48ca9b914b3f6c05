"""rorg dev"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from rorg.cli.kinds import DIRECTORY, service_name
from rorg.cli.names import complete_services
from rorg.cli.options import Output, RobotManifests, Yes
from rorg.cli.output import print_rows
from rorg.errors import Invalid

Name = Annotated[
    str | None,
    typer.Argument(
        help="A service or an image; image/NAME if a service has the same name. Default: list the containers.",
        parser=service_name,
        autocompletion=complete_services,
    ),
]
Workspace = Annotated[
    Path | None,
    typer.Option(help="Directory to work in, at the same path inside. Default: the current one.", click_type=DIRECTORY),
]
Devcontainer = Annotated[
    bool,
    typer.Option("--devcontainer", help="Only write .devcontainer/devcontainer.json in the workspace, for editors."),
]
Fresh = Annotated[bool, typer.Option("--fresh", help="Create the container again; the workspace and the home stay.")]


def command(
    context: RobotManifests,
    name: Name = None,
    command: Annotated[list[str] | None, typer.Argument(help="A command, after `--`, instead of a shell.")] = None,
    *,
    fresh: Fresh = False,
    stop: Annotated[bool, typer.Option("--stop", help="Stop and remove it; without a name, all of them.")] = False,
    called: Annotated[str, typer.Option("--name", help="Name of the container. Default: NAME-dev.")] = "",
    workspace: Workspace = None,
    x11: Annotated[bool, typer.Option("--x11", help="Let programs open windows on this screen.")] = False,
    gpu: Annotated[bool, typer.Option("--gpu", help="Give it all GPUs.")] = False,
    devcontainer: Devcontainer = False,
    yes: Yes = False,
    output: Output = "table",
) -> None:
    """Open a shell in a service's own image, with its mounts, devices, network and limits, and your workspace. The
    container stays when the shell ends; the same command enters it again.

    Example: rorg dev navigation --workspace ~/ws -- make
    """
    from rorg.cli.dev_containers import Developing, Wish, rows

    if stop + devcontainer + bool(fresh or command) > 1:
        why = "--stop and --devcontainer exclude the other actions"
        raise Invalid("combine these options", why, "one after the other")
    if command and not command[0]:
        raise Invalid(f"run a command to develop {name}", "it has no name", f"`rorg dev {name} -- COMMAND`")
    if name is None and (fresh or devcontainer or (called and not stop)):
        raise Invalid("open a dev container", "no service or image is named", "`rorg dev NAME`")
    robot = Developing(context)
    if stop:
        robot.stop(name, called)
    elif name is None:
        print_rows(rows(robot.containers.list()), output, ("name", "of", "state", "workspace"), ("user", "extras"))
    else:
        wish = Wish(robot.context, name, called, workspace, x11, gpu)
        if devcontainer:
            robot.write(wish, yes)
        else:
            sys.exit(robot.enter(wish, command or (), fresh, yes))
