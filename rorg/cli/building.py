"""How a build goes on, for people: on a terminal a line for each image that is being built, elsewhere a line for each
step."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from rorg.cli.output import note
from rorg.cli.terminal import printable

if TYPE_CHECKING:
    from rich.console import RenderableType

    from rorg.images.order import Listener, Order, Result


@contextlib.contextmanager
def shown(names: Mapping[str, str]) -> Iterator[Listener]:
    """Who hears of the build in the block. `names`: reference -> what people call it, where that is something else.
    Being told to end is an exception there, so that nothing goes on without us."""
    before = signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    try:
        if sys.stderr.isatty():
            with Screen(names) as screen:
                yield screen
        else:
            yield Lines(names)
    finally:
        signal.signal(signal.SIGTERM, before)


def ending(names: Mapping[str, str], result: Result) -> str:
    """The line about an image that is done."""
    seconds = f" ({result.seconds:.1f} s)" if result.seconds >= 0.05 else ""
    why = f": {result.message}" if result.message else ""
    return f"{result.outcome:<8} {names.get(result.reference, result.reference)}{seconds}{why}"


class Lines:
    """Plain lines, of all steps but how much has been pulled."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = names

    def began(self, order: Order) -> None:
        """The first step says it."""

    def step(self, order: Order, text: str) -> None:
        if order.image:
            note(f"         {order.name}: {text}")

    def ended(self, result: Result) -> None:
        note(ending(self._names, result))


class Screen:
    """Lines that are rewritten in place, below those about what is done."""

    def __init__(self, names: Mapping[str, str]) -> None:
        from rich.console import Console
        from rich.live import Live

        self._names = names
        self._steps: dict[str, tuple[float, str]] = {}
        self._live = Live(
            console=Console(stderr=True), get_renderable=self._render, refresh_per_second=4, transient=True
        )

    def __enter__(self) -> Screen:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def began(self, order: Order) -> None:
        self._steps[order.reference] = (time.monotonic(), "")

    def step(self, order: Order, text: str) -> None:
        self._steps[order.reference] = (self._steps[order.reference][0], text)

    def ended(self, result: Result) -> None:
        from rich.text import Text

        self._steps.pop(result.reference, None)
        style = "" if result.good else "red"
        self._live.console.print(Text(printable(ending(self._names, result)), style=style), soft_wrap=True)

    def _render(self) -> RenderableType:
        from rich.text import Text

        now = time.monotonic()
        rows = [
            f"  {self._names.get(r, r)}  {now - began:.0f} s  {step}" for r, (began, step) in list(self._steps.items())
        ]
        return Text("\n".join(map(printable, rows)), no_wrap=True, overflow="ellipsis")
