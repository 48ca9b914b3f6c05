"""rorg image"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rorg.cli.context import Context
from rorg.cli.options import Output, Tree, Yes
from rorg.cli.output import consent, disk_errors, missing, note, print_rows
from rorg.errors import EngineError, Invalid, NotReady, Refused
from rorg.model.engines import capabilities_of
from rorg.model.image_names import declared
from rorg.model.units import counted, format_memory, stamp

if TYPE_CHECKING:
    from rorg.engines.protocol import Images
    from rorg.images.disk_usage import Kept
    from rorg.images.records import Records
    from rorg.images.references import Content
    from rorg.model.catalog import Catalog

ACTIONS = ("list", "prune", "save", "load")


def command(
    context: Tree,
    action: Annotated[
        Literal["list", "prune", "save", "load"], typer.Argument(help="list, prune, save FILE [IMAGE...] or load FILE.")
    ],
    names: Annotated[list[str], typer.Argument(help="A file, and images. Default: all that services use.")] = [],  # noqa: B006
    *,
    keep: Annotated[int | None, typer.Option(help="For prune: number of revisions whose images stay.", min=1)] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="For prune: only show what rorg would remove.")] = False,
    yes: Yes = False,
    output: Output = "table",
) -> None:
    """List the images that rorg has built, with their size and why they are kept. Prune the ones that no rollback
    can need. Save a robot's images to a file, and load them on another machine.

    Example: rorg image prune --keep 3
    """
    if action in ("save", "load") and not names:
        raise Invalid(f"{action} images", "no file is named", f"`rorg image {action} FILE`")
    if action in ("list", "prune", "load") and len(names) > (action == "load"):
        raise Invalid(f"{action} images", f"unexpected argument '{names[-1]}'", f"`rorg image {action}`")
    robot = _Robot(context)
    if action == "list":
        _print(robot.kept(None), output)
    elif action == "prune":
        _prune(robot, keep, dry_run, yes, output)
    elif action == "save":
        _save(robot, Path(names[0]), names[1:])
    else:
        _load(robot, Path(names[0]))


class _Robot:
    """What the actions work on."""

    def __init__(self, context: Context) -> None:
        from rorg.images.references import references_for

        self.context = context
        self.engine: Images = _with_images(context)
        self.catalog: Catalog = context.catalog()
        references = references_for(context.engine_name, context.state.path)
        self.records: Records = references.records
        self.content: Content = references.of(self.catalog)

    def kept(self, keep: int | None) -> list[Kept]:
        from rorg.images.disk_usage import own_images

        owner = self.context.state.instance()
        keep = keep or self.catalog.policy.images.keep
        return own_images(
            self.engine.images(), owner, set(self.content.references.values()), self.records.revisions(), keep
        )


def _with_images(context: Context) -> Images:
    from rorg.engines.protocol import Images

    context.here("look after images")
    engine = context.engine() if capabilities_of(context.engine_name).images else None
    if not isinstance(engine, Images):
        raise Refused(
            f"look after images on the engine '{context.engine_name}'",
            "its images are only names for folders of programs",
            "--engine docker",
        )
    return engine


def _print(images: list[Kept], output: str) -> None:
    rows = [
        {
            "name": image.name,
            "reference": image.references[0] if image.references else image.id.removeprefix("sha256:")[:12],
            "size": format_memory(image.size),
            "own": format_memory(image.size - image.shared),
            "kept for": ", ".join(image.reasons) or "-",
            "id": image.id.removeprefix("sha256:")[:12],
            "created": stamp(image.created),
        }
        for image in images
    ]
    full = [image.as_json() for image in images]
    print_rows(rows, output, ("name", "reference", "size", "own", "kept for"), ("id", "created"), full=full)


def _prune(robot: _Robot, keep: int | None, dry_run: bool, yes: bool, output: str) -> None:
    going = [image for image in robot.kept(keep) if not image.reasons]
    _print(going, output)
    freed = format_memory(sum(image.freed for image in going))
    if not dry_run:
        robot.records.forget(_lost(robot, keep))
    if dry_run or not going:
        note(f"{counted(len(going), 'image')} would be removed, {freed}" if going else "nothing to remove")
        return
    if not yes:
        consent(f"remove {counted(len(going), 'image')}", f"Remove them ({freed})?")
    failed, gone = [], []
    for image in going:
        for reference in image.references or (image.id,):
            try:
                robot.engine.remove_image(reference)
                gone.append(reference)
            except EngineError as error:
                failed.append(f"{reference}: {error.why}")
    robot.records.forget(gone)
    if failed:
        raise NotReady("remove all of them", "; ".join(failed), "`docker rmi` for the reason")
    note(f"{counted(len(going), 'image')} removed, {freed} freed")


def _lost(robot: _Robot, keep: int | None) -> set[str]:
    """References on record that the engine no longer has and nothing wants: an earlier prune was killed."""
    used = robot.records.revisions()[: keep or robot.catalog.policy.images.keep]
    wanted = {*robot.content.references.values(), *(r for revision in used for r in revision)}
    return robot.engine.missing_images({b.reference for b in robot.records.built().values()} - wanted)


def _save(robot: _Robot, path: Path, names: list[str]) -> None:
    from rorg.images.archive import write_archive
    from rorg.store.files import sync

    for name in names:
        if not declared(name, robot.catalog.images):
            raise missing("image", name, robot.catalog.images)
    used = names or sorted({str(s.spec["image"]) for s in robot.catalog.services.values() if s.spec})
    references = [robot.content.references.get(declared(n, robot.catalog.images), n) for n in used]
    lacking = robot.engine.missing_images(references)
    if lacking:
        raise Invalid("save images", f"not on this machine: {', '.join(sorted(lacking))}", "`rorg build` first")
    saved = {i: b for i, b in robot.records.built().items() if b.reference in references}
    part = path.with_name(f".{path.name}.part")
    try:
        with (
            disk_errors(f"write {path}", "another place"),
            part.open("wb") as file,
            robot.engine.save_images(references) as blocks,
        ):
            write_archive(blocks, saved, file)
            file.flush()
            os.fsync(file.fileno())
        with disk_errors(f"write {path}", "another place"):
            part.replace(path)
            sync(path.parent)
    finally:
        part.unlink(missing_ok=True)
    note(f"{counted(len(references), 'image')} in {path}")


def _load(robot: _Robot, path: Path) -> None:
    from rorg.images.archive import read_records
    from rorg.regular_file import open_regular

    with disk_errors(f"read {path}", "the file that `rorg image save` wrote"), open_regular(path) as file:
        built = read_records(file, str(path))
        file.seek(0)
        loaded = robot.engine.load_images(file)
    if not loaded:
        raise Invalid(f"load {path}", "it contains no image", "an archive that `rorg image save` wrote")
    robot.context.state.prepare()
    robot.records.note(built)
    note(f"{counted(loaded, 'image')} loaded")
