"""rorg build"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rorg.cli.names import complete_images
from rorg.cli.options import BuildTree, Output
from rorg.cli.output import missing, note, print_rows
from rorg.cli.terminal import entry, printable
from rorg.errors import NotReady
from rorg.model.image_names import declared
from rorg.store.files import read_state

if TYPE_CHECKING:
    from rich.console import RenderableType

    from rorg.images.order import Listener, Order, Result

MOST = 4
"""Parallel builds by default: more do not make an engine faster."""
TOLD = 10
"""Lines of the log that are shown of a failed build."""


def command(
    context: BuildTree,
    images: Annotated[
        list[str],
        typer.Argument(
            help="Images to build, with their parents. Default: all of the tree.", autocompletion=complete_images
        ),
    ] = [],  # noqa: B006
    *,
    pull: Annotated[bool, typer.Option("--pull", help="Pull external images again.")] = False,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Do not use the engine's build cache.")] = False,
    jobs: Annotated[
        int | None, typer.Option("-j", "--jobs", help="Parallel builds. Default: one per processor, at most 4.", min=1)
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print what rorg would do, and do nothing.")] = False,
    output: Output = "table",
) -> None:
    """Build the images of the tree, parents before children, and pull missing base images. Exit 4 if one fails.

    Example: rorg build navigation --pull
    """
    from rorg.images.references import references_for
    from rorg.images.supply import Supplier

    catalog = context.catalog()
    for name in images:
        if not declared(name, catalog.images):
            raise missing("image", name, catalog.images)
    used = {s.spec["image"] for s in catalog.services.values() if s.spec}
    names = images or sorted({*catalog.images, *(u for u in used if not declared(u, catalog.images))})
    state, of = context.state.prepare(), context.engine()
    content = references_for(context.engine_name, state.path).of(catalog)
    supplier = Supplier(of, state, of.owner, jobs or min(os.cpu_count() or 1, MOST))
    if dry_run:
        _print_orders(supplier.orders(catalog, content, names, not no_cache), output)
        return
    called = content.names
    with shown(called) as listener:
        results = supplier.supply(catalog, content, names, listener=listener, pull=pull, cache=not no_cache)
    _print_results(called, results, output)


def _print_orders(orders: Sequence[Order], output: str) -> None:
    """Prints what rorg would build and pull, in order."""
    rows = [{"image": o.name, "action": _action(o), "reference": o.reference, "after": list(o.below)} for o in orders]
    print_rows(rows, output, ("image", "action"), ("reference",))


def _action(order: Order) -> str:
    if order.image is None:
        return "nothing" if order.there and not order.pull else "pull"
    return "nothing" if order.there else "import" if order.image.import_command is not None else "build"


def _print_results(called: Mapping[str, str], results: Sequence[Result], output: str) -> None:
    """Raises NotReady if an image is missing."""
    if output != "table":
        rows = [
            {"image": called.get(r.reference, r.reference), **asdict(r), "seconds": round(r.seconds, 3)}
            for r in results
        ]
        print_rows(rows, output, ("image", "outcome"), ("message",), full=rows)
    for result in results:
        if result.outcome == "failed":
            _tell_failure(called.get(result.reference, result.reference), result)
    failed = [called.get(r.reference, r.reference) for r in results if not r.good]
    if failed:
        raise NotReady(
            "build all images",
            f"{len(failed)} of {len(results)} failed or were skipped: {', '.join(failed)}",
            "to fix the first one, then `rorg build NAME`",
        )
    note(f"{len(results)} images are there")


def _tell_failure(name: str, result: Result) -> None:
    """Prints the failed instruction, the last lines of the log, and the file with all of it."""
    note(f"{name} failed{' at ' + result.step if result.step else ''}: {result.message}")
    try:
        lines = read_state(Path(result.log)).splitlines()[-TOLD:] if result.log else []
    except OSError:
        return  # it has no log yet
    for line in lines:
        note(entry("  | ", line))
    if lines:
        note(f"  all of it: {result.log}")


@contextlib.contextmanager
def shown(names: Mapping[str, str]) -> Iterator[Listener]:
    """Gives the listener that shows the build while the block runs. `names`: reference -> the name to show, if that
    differs. SIGTERM raises an exception meanwhile, so that no build goes on without rorg."""
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
    """The line about a finished image."""
    seconds = f" ({result.seconds:.1f} s)" if result.seconds >= 0.05 else ""
    why = f": {result.message}" if result.message else ""
    return f"{result.outcome:<8} {names.get(result.reference, result.reference)}{seconds}{why}"


class Lines:
    """Prints a line for each step, except progress of pulls."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = names

    def began(self, order: Order) -> None:
        """Nothing: the first step names the image."""

    def step(self, order: Order, text: str) -> None:
        if order.image:
            note(f"         {order.name}: {text}")

    def ended(self, result: Result) -> None:
        note(ending(self._names, result))


class Screen:
    """Shows running builds in lines that are rewritten in place, below those of finished images."""

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
