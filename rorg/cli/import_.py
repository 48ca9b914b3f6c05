"""rorg import"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

from rorg.cli.options import DIRECTORIES, FILES, FORMS, Argument, Option

if TYPE_CHECKING:
    from rorg.importing.manifests import Imported

SOURCES = ("compose", "systemd", "roslaunch")


def command(
    what: Annotated[str, Argument(help="compose, systemd or roslaunch.", completes=SOURCES)],
    files: Annotated[
        list[str],
        Argument(
            help="Compose files, later ones override earlier ones (default: ./compose.yaml); systemd units; or a "
            "launch file with its arguments as ARG:=VALUE.",
            show_default=False,
            completes=FILES,
        ),
    ] = [],  # noqa: B006
    env_file: Annotated[
        list[str],
        Option(
            names=("--env-file",),
            help="For compose: read this file instead of .env.",
            show_default=False,
            completes=FILES,
        ),
    ] = [],  # noqa: B006
    profile: Annotated[
        list[str],
        Option(names=("--profile",), help="For compose: include services of this profile.", show_default=False),
    ] = [],  # noqa: B006
    project_name: Annotated[
        str, Option(names=("--project-name",), help="For compose: name of the project.", show_default=False)
    ] = "",
    image: Annotated[
        str,
        Option(names=("--image",), help="For systemd and roslaunch: the image of the services.", show_default=False),
    ] = "",
    output: Annotated[
        Path, Option(names=("--output",), help="Directory to write the manifests to.", completes=DIRECTORIES)
    ] = Path("manifests"),
    force: Annotated[bool, Option(names=("--force",), help="Overwrite existing files.")] = False,
    form: Annotated[str, Option(names=("-o",), help="table, wide, name, yaml or json.", completes=FORMS)] = "table",
) -> None:
    """Write manifests for a Compose project, systemd units or a launch file. Every change or loss is noted. If
    something cannot be carried over, rorg lists all of it and writes nothing.

    Example: rorg import compose compose.yaml
    """
    from rorg.cli.output import check_form
    from rorg.errors import Invalid

    check_form(form)
    if what not in SOURCES:
        raise Invalid(f"import '{what}'", "there is no such source", f"one of {', '.join(SOURCES)}")
    if what == "compose":
        imported = _compose([Path(f) for f in files], env_file, profile, project_name, output)
    elif not files:
        raise Invalid(f"import from {what}", "no file is named", f"`rorg import {what} FILE`")
    elif what == "systemd":
        imported = _systemd([Path(f) for f in files], image, output)
    else:
        imported = _roslaunch(Path(files[0]), files[1:], image, output)
    if imported.errors:
        _refuse(imported, what, form)
    _write(imported, output, force)
    _tell(imported, output, form)


def _compose(paths: list[Path], env_files: list[str], profiles: list[str], name: str, output: Path) -> Imported:
    from rorg.compose.load import load
    from rorg.errors import Invalid
    from rorg.importing.compose import from_compose
    from rorg.importing.manifests import Imported

    for path in paths:
        if not path.exists():
            raise Invalid(f"read {path}", "there is no such file", "a path that is there")
    loaded = load(
        paths or [Path(".")],
        os.environ,
        env_files=[Path(f) for f in env_files] or None,
        profiles=profiles,
        name=name or None,
    )
    if loaded.project is None:
        return Imported(diagnostics=loaded.diagnostics)
    tree = output.resolve()
    top = _repository(loaded.project.directory.resolve())
    found = from_compose(loaded.project, tree, top, os.environ, _text)
    return found.with_diagnostics(loaded.diagnostics)


def _repository(directory: Path) -> Path:
    """The top of the repository that a directory is in; itself where it is in none."""
    return next((d for d in (directory, *directory.parents) if (d / ".git").exists()), directory)


def _text(path: Path) -> str | None:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError):
        return None


def _read(path: Path) -> str:
    from rorg.errors import Invalid

    try:
        return path.read_text()
    except OSError as error:
        raise Invalid(f"read {path}", str(error.strerror), "another file") from error
    except UnicodeDecodeError as error:
        raise Invalid(f"read {path}", "it is not UTF-8", "another file") from error


def _systemd(paths: list[Path], image: str, output: Path) -> Imported:
    from rorg.importing.systemd import from_systemd

    return from_systemd({path: _read(path) for path in paths}, image, output.resolve())


def _roslaunch(path: Path, words: list[str], image: str, output: Path) -> Imported:
    from rorg.errors import Invalid
    from rorg.importing.roslaunch import from_roslaunch

    wrong = next((word for word in words if ":=" not in word), None)
    if wrong is not None:
        raise Invalid(f"import {path}", f"'{wrong}' is no argument of a launch file", "ARG:=VALUE")
    arguments = dict(word.split(":=", 1) for word in words)
    return from_roslaunch(path, _text, arguments, image, with_master=not (output / "services/roscore.yaml").exists())


def _refuse(imported: Imported, what: str, form: str) -> NoReturn:
    from rorg.cli.output import dump
    from rorg.errors import Invalid
    from rorg.model.units import counted

    _notes(imported, form)
    if form in ("json", "yaml"):
        dump(_whole(imported, None), form)
    raise Invalid(f"import from {what}", f"{counted(len(imported.errors), 'error')}; nothing is written", "mending it")


def _notes(imported: Imported, form: str) -> None:
    from rorg.cli.differences import line
    from rorg.cli.output import note

    for diagnostic in imported.diagnostics if form not in ("json", "yaml") else ():
        note(line(diagnostic.as_json()))


def _write(imported: Imported, output: Path, force: bool) -> None:
    """All of it, or nothing where something is there already."""
    from rorg.errors import Invalid, Refused
    from rorg.manifest.schema import write

    texts = imported.texts
    there = [str(output / path) for path in texts if (output / path).exists()]
    if there and not force:
        some = ", ".join(there[:3]) + (f" and {len(there) - 3} more" if len(there) > 3 else "")
        raise Refused(f"write manifests into {output}", f"{some} is there", "--force, or another --output")
    try:
        for name, text in texts.items():
            path = output / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)
            path.touch(0o600 if name in imported.private else 0o644)
            path.write_text(text)
        write(output / "schemas", check=False)
    except OSError as error:
        why = f"{error.filename}: {error.strerror}"
        raise Invalid(f"write manifests into {output}", why, "another --output") from error


def _tell(imported: Imported, output: Path, form: str) -> None:
    from collections import Counter

    from rorg.cli.output import note, print_rows
    from rorg.model.units import counted

    _notes(imported, form)
    rows = [{"file": str(output / m.path), "kind": m.kind, "name": m.name} for m in imported.manifests]
    print_rows(rows, form, ("file", "kind", "name"), full=_whole(imported, output))
    kinds = Counter(m.kind.lower() for m in imported.manifests)
    told = [d.severity for d in imported.diagnostics]
    counts = [counted(n, kind) for kind, n in kinds.items()]
    counts += [counted(told.count(word), word) for word in ("warning", "note") if word in told]
    note(f"{output}: {', '.join(counts)}\nnext: rorg validate {output}")


def _whole(imported: Imported, output: Path | None) -> dict[str, Any]:
    """For programs. Where nothing is written, `files` is empty."""
    return {
        "files": sorted(str(output / path) for path in imported.texts) if output else [],
        "manifests": [{"kind": m.kind, "name": m.name, "file": m.path} for m in imported.manifests],
        "diagnostics": [d.as_json() for d in imported.diagnostics],
    }
