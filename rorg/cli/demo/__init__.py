"""rorg demo"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from rorg.cli.kinds import numbers
from rorg.cli.options import EngineName


def command(
    engine: EngineName = None,
    speed: Annotated[float, typer.Option(help="Speed; 2 is twice as fast.", parser=numbers(0.1, 20))] = 1.0,
    keep: Annotated[
        bool, typer.Option("--keep", help="Leave the robot and its rorg running at the end, to look at.")
    ] = False,
    svg: Annotated[str | None, typer.Option(help="Save a picture of standby and tour to this file.")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", help="Print every action of rorg.")] = False,
) -> None:
    """Play the work of a tour-guide robot with stand-in programs: a tour, a crash, a bad update. Leave nothing behind.

    Example: rorg demo --engine process --speed 2
    """
    import signal

    from rorg.cli.demo.robot import DemoRobot, choose_engine
    from rorg.cli.demo.show import Show
    from rorg.cli.demo.story import play

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    show = Show(speed, verbose, svg)
    chosen, why = choose_engine(engine)
    show.title(f"rorg demo: a tour guide on the {chosen} engine ({why})")
    robot = DemoRobot(chosen)
    kept = False
    try:
        play(robot, show, keep)
        kept = keep
    except KeyboardInterrupt:
        show.line("interrupted")
        sys.exit(130)
    finally:
        show.close()
        if not kept:
            robot.clean_up(show.line)
