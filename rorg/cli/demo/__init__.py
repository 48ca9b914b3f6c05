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
    keep: Annotated[bool, typer.Option("--keep", help="Keep the robot running at the end.")] = False,
    svg: Annotated[str | None, typer.Option(help="Save a picture of standby and tour to this file.")] = None,
) -> None:
    """Run a tour-guide robot of stand-in services through its work, and leave nothing behind.

    Example: rorg demo --engine process --speed 2
    """
    import signal

    from rorg.cli.demo.robot import DemoRobot, choose_engine
    from rorg.cli.demo.show import Show
    from rorg.cli.demo.tour import play

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    show = Show(speed, svg)
    chosen, why = choose_engine(engine)
    show.title(f"rorg demo on the {chosen} engine ({why})")
    robot = DemoRobot(chosen, show)
    try:
        play(robot, show)
    except KeyboardInterrupt:
        show.line("interrupted")
        sys.exit(130)
    finally:
        show.close()
        if keep:
            robot.keep()
        else:
            show.line("cleaning up")
            robot.clean_up(show.line)
