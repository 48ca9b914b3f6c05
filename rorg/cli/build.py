"""rorg build"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rorg.cli.options import (
    Argument,
    EngineName,
    ManifestsDirectory,
    Option,
    Output,
    OwnStateDirectory,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rorg.images.order import Order, Result

MOST = 4
"""Images that are built at once where nobody says: more make an engine no faster."""
TOLD = 10
"""Lines of the log of a build that failed."""


def command(
    images: Annotated[
        list[str],
        Argument(
            help="Images to build, with their parents. Default: all of the tree.",
            show_default=False,
            completes="images",
        ),
    ] = [],  # noqa: B006
    directory: ManifestsDirectory = None,
    pull: Annotated[bool, Option(names=("--pull",), help="Pull external images again.")] = False,
    no_cache: Annotated[bool, Option(names=("--no-cache",), help="Do not use the engine's build cache.")] = False,
    jobs: Annotated[
        int | None,
        Option(names=("-j", "--jobs"), least=1, help="Parallel builds. Default: one per processor, at most 4."),
    ] = None,
    dry_run: Annotated[bool, Option(names=("--dry-run",), help="Print what rorg would do, and do nothing.")] = False,
    state_dir: OwnStateDirectory = None,
    engine: EngineName = None,
    output: Output = "table",
) -> None:
    """Build the images of the tree, parents before children, and pull missing base images. Exit 4 if one fails.

    Example: rorg build navigation --pull
    """
    from rorg.cli.building import shown
    from rorg.cli.context import Context
    from rorg.cli.output import check_form, missing
    from rorg.images.references import references_for
    from rorg.images.supply import Supplier
    from rorg.model.image_names import declared

    check_form(output)
    context = Context(state_dir, engine, Path(directory) if directory else None, local=True, own=True)
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
        results = supplier.supply(catalog, content, names, listener, pull=pull, cache=not no_cache)
    _print_results(called, results, output)


def _print_orders(orders: Sequence[Order], output: str) -> None:
    """What would be done, in order."""
    from rorg.cli.output import print_rows

    rows = [{"image": o.name, "action": _action(o), "reference": o.reference, "after": list(o.below)} for o in orders]
    print_rows(rows, output, ("image", "action"), ("reference",))


def _action(order: Order) -> str:
    if order.image is None:
        return "nothing" if order.there and not order.pull else "pull"
    return "nothing" if order.there else "import" if order.image.import_command is not None else "build"


def _print_results(called: Mapping[str, str], results: Sequence[Result], output: str) -> None:
    """Raises NotReady where not all are there."""
    from rorg.cli.output import note, print_rows
    from rorg.errors import NotReady

    if output != "table":
        rows = [
            {
                "image": called.get(r.reference, r.reference),
                "outcome": r.outcome,
                "message": r.message,
                "reference": r.reference,
                "step": r.step,
                "seconds": round(r.seconds, 3),
                "id": r.id,
                "log": r.log,
            }
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
            "fixing the first one, then `rorg build NAME`",
        )
    note(f"{len(results)} images are there")


def _tell_failure(name: str, result: Result) -> None:
    """The instruction, the last lines of the log, and where all of it is."""
    from rorg.cli.output import note
    from rorg.cli.terminal import entry
    from rorg.store.files import read_state

    note(f"{name} failed{' at ' + result.step if result.step else ''}: {result.message}")
    try:
        lines = read_state(Path(result.log)).splitlines()[-TOLD:] if result.log else []
    except OSError:
        return  # it had no log yet
    for line in lines:
        note(entry("  | ", line))
    if lines:
        note(f"  all of it: {result.log}")
