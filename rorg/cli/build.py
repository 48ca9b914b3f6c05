"""rorg build"""

from __future__ import annotations

from typing import Annotated, Any

from rorg.cli.options import Directory, EngineName, Option, Output, OwnStateDirectory


def command(
    directory: Directory = None,
    only: Annotated[
        list[str], Option(names=("--image",), help="Only this image and what it stands on.", completes="images")
    ] = [],  # noqa: B006
    state_dir: OwnStateDirectory = None,
    engine: EngineName = None,
    output: Output = "table",
) -> None:
    """Build the images of the tree, parents before children; pull what is missing. Exits 4 when one fails.

    Example: rorg build --image navigation
    """
    from rorg.cli.context import Context
    from rorg.cli.output import check_form, missing, note, print_rows
    from rorg.errors import NotReady
    from rorg.images.build import build

    check_form(output)
    context = Context(state_dir, engine, directory, local=True, own=True)
    catalog = context.catalog()
    for name in only:
        if name not in catalog.images:
            raise missing("image", name, catalog.images)
    used = {s.spec["image"] for s in catalog.services.values() if s.spec}
    results = build(catalog, only or sorted({*catalog.images, *used}), make_builder(context, catalog), note)
    if output != "table":
        rows = [{"image": r.image, "outcome": r.outcome, "message": r.message} for r in results]
        print_rows(rows, output, ("image", "outcome"), ("message",), full=rows)
    failed = [r.image for r in results if r.outcome in ("failed", "skipped")]
    if failed:
        raise NotReady(
            "build all images",
            f"{len(failed)} of {len(results)} failed or were skipped: {', '.join(failed)}",
            "fixing the first one, then `rorg build --image NAME`",
        )
    note(f"{len(results)} images are there")


def make_builder(context: Any, catalog: Any) -> Any:
    """The builder of the context's engine."""
    from rorg.images.build import ProcessBuilder

    if context.engine_name == "process":
        return ProcessBuilder(catalog, context.state.prepare().path)
    from rorg.images.docker import DockerBuilder

    return DockerBuilder(context.engine())
