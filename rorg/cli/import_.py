"""rorg import"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from rorg.cli.context import known_engine
from rorg.cli.differences import line
from rorg.cli.kinds import DIRECTORY, FILE, FILE_NAME
from rorg.cli.options import Form
from rorg.cli.output import disk_errors, dump, note, print_rows
from rorg.cli.validate import findings, refuse
from rorg.errors import Invalid, Refused
from rorg.model.units import counted

if TYPE_CHECKING:
    from rorg.tools.importing.manifests import Imported

SOURCES = ("compose", "systemd", "roslaunch", "launch")

Files = Annotated[
    list[str],
    typer.Argument(
        help="Compose files, later ones override earlier ones (default: ./compose.yaml); systemd units; or a "
        "launch file with its arguments as ARG:=VALUE.",
        click_type=FILE_NAME,
    ),
]
Also = Annotated[
    list[Path],
    typer.Option(
        "--read",
        help="Also allow reading this file or directory outside the project's folder.",
        click_type=FILE,
    ),
]
Skip = Annotated[
    bool,
    typer.Option(
        "--skip-unsupported", help="Leave out what cannot be carried over, with a warning for each; write the rest."
    ),
]
What = Annotated[
    Literal["compose", "systemd", "roslaunch", "launch"],
    typer.Argument(help="compose, systemd or roslaunch; launch is the same as roslaunch."),
]
Ros = Annotated[
    Literal["1", "2"] | None,
    typer.Option(help="For roslaunch: the ROS of the launch file, if it cannot be detected."),
]
EnvFile = Annotated[list[Path], typer.Option(help="For compose: read this file instead of .env.", click_type=FILE)]


def command(
    what: What,
    files: Files = [],  # noqa: B006
    *,
    env_file: EnvFile = [],  # noqa: B006
    profile: Annotated[list[str], typer.Option(help="For compose: include services of this profile.")] = [],  # noqa: B006
    project_name: Annotated[str, typer.Option(help="For compose: name of the project.")] = "",
    ros: Ros = None,
    image: Annotated[str, typer.Option(help="For systemd and roslaunch: the image of the services.")] = "",
    also: Also = [],  # noqa: B006
    output: Annotated[Path, typer.Option(help="Directory to write the manifests to.", click_type=DIRECTORY)] = Path(
        "manifests"
    ),
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
    skip: Skip = False,
    form: Annotated[Form, typer.Option("-o", help="table, wide, name, yaml or json.")] = "table",
) -> None:
    """Write manifests for a Compose project, systemd units or a launch file. Every change or loss is noted. If
    something cannot be carried over, rorg lists all of it and writes nothing. Then validate the manifests: exit code 0
    means that `rorg validate` accepts them.

    Example: rorg import compose compose.yaml
    """
    if what == "compose":
        imported = _compose(
            [Path(f) for f in files], env_file, profile, project_name, output=output, named=also, skip=skip
        )
    elif not files:
        raise Invalid(f"import from {what}", "no file is named", f"`rorg import {what} FILE`")
    elif what == "systemd":
        imported = _systemd([Path(f) for f in files], image, output, skip)
    else:
        imported = _roslaunch(Path(files[0]), files[1:], image, output, named=also, ros=int(ros or 0), skip=skip)
    if imported.errors:
        _refuse(imported, what, form)
    _write(imported, output, force)
    without_image = what == "systemd" and not image
    _tell(imported, output, form, "run --engine process" if without_image else "run")


def _compose(
    paths: list[Path],
    env_files: list[Path],
    profiles: list[str],
    name: str,
    *,
    output: Path,
    named: list[Path],
    skip: bool,
) -> Imported:
    from rorg.manifest.files import Reader
    from rorg.tools.compose.load import load
    from rorg.tools.importing.compose import from_compose
    from rorg.tools.importing.manifests import Imported

    for path in paths:
        if not path.exists():
            raise Invalid(f"read {path}", "no such file", "another path")
    read = Reader(_project_folder(paths[0] if paths else Path()), [*paths, *env_files, *named])
    paths = paths or [Path()]
    loaded = load(paths, os.environ, read, env_files=env_files or None, profiles=profiles, name=name or None)
    if loaded.project is None:
        return Imported(diagnostics=loaded.diagnostics)
    tree = output.resolve()
    top = _repository(loaded.project.directory.resolve())

    def text(path: Path) -> str | None:
        try:
            return read(path)
        except OSError:
            return None

    imported = from_compose(loaded.project, tree, top, text, skip)
    return imported.with_diagnostics(loaded.diagnostics)


def _repository(directory: Path) -> Path:
    """The top directory of the repository that a directory is in; the directory itself without a repository."""
    return next((d for d in (directory, *directory.parents) if (d / ".git").exists()), directory)


def _project_folder(path: Path) -> Path:
    """The directory that a project may read from: its repository, or its ROS package, or its own directory. A home
    directory that is a repository is not a project."""
    home = Path(os.path.expanduser("~"))
    own = path.resolve() if path.is_dir() else path.resolve().parent
    around = [d for d in (own, *own.parents) if not home.is_relative_to(d)]
    for mark in (".git", "package.xml"):
        directory = next((d for d in around if (d / mark).exists()), None)
        if directory:
            return directory
    return own


def _systemd(paths: list[Path], image: str, output: Path, skip: bool) -> Imported:
    from rorg.manifest.files import Reader
    from rorg.tools.importing.systemd import from_systemd
    from rorg.tools.importing.systemd_unit import template_of

    texts = {}
    for path in paths:
        source = path if path.exists() else template_of(path)
        with disk_errors(f"read {path}", "another file"):
            texts[path] = Reader(source, [source])(source)
    return from_systemd(texts, image, output.resolve(), skip)


def _roslaunch(
    path: Path, words: list[str], image: str, output: Path, *, named: list[Path], ros: int, skip: bool
) -> Imported:
    from rorg.manifest.files import Reader
    from rorg.tools.importing.roslaunch import from_roslaunch

    wrong = next((word for word in words if ":=" not in word), None)
    if wrong is not None:
        raise Invalid(f"import {path}", f"'{wrong}' is not an argument of a launch file", "ARG:=VALUE")
    arguments = dict(word.split(":=", 1) for word in words)
    read = Reader(_project_folder(path), [path, *named])
    with_master = not (output / "services/roscore.yaml").exists()
    return from_roslaunch(path, read, arguments, image, with_master, ros=ros, environment=os.environ, skip=skip)


def _refuse(imported: Imported, what: str, form: str) -> NoReturn:
    _notes(imported, form)
    if form in ("json", "yaml"):
        dump(_whole(imported, None), form)
    skip = "--skip-unsupported to leave these out" if imported.manifests else "`rorg import --help` for options"
    raise Invalid(
        f"import from {what}",
        f"{counted(len(imported.errors), 'error')}; nothing is written",
        f"{skip}, or edit the source",
    )


def _notes(imported: Imported, form: str) -> None:
    for diagnostic in imported.diagnostics if form not in ("json", "yaml") else ():
        note(line(diagnostic.as_json()))


def _write(imported: Imported, output: Path, force: bool) -> None:
    """Writes all files, or none if one of them exists."""
    from rorg.tools.importing.manifests import existing_files, write_tree

    there = [str(path) for path in existing_files(imported, output)]
    if there and not force:
        some = ", ".join(there[:3]) + (f" and {len(there) - 3} more" if len(there) > 3 else "")
        raise Refused(f"write manifests into {output}", f"{some} exists already", "--force, or another --output")
    with disk_errors(f"write manifests into {output}", "another --output"):
        write_tree(imported, output)


def _tell(imported: Imported, output: Path, form: str, then: str) -> None:
    """Reports what was written, what `rorg validate` finds in it, and the command that comes `then`. Exits with
    the code of `rorg validate` if there are errors."""
    from collections import Counter

    _notes(imported, form)
    diagnostics = findings(output, known_engine(None))[0]
    errors = [d for d in diagnostics if d.severity == "error"]
    rows = [{"file": str(output / m.path), "kind": m.kind, "name": m.name} for m in imported.manifests]
    whole = {**_whole(imported, output), "valid": not errors, "findings": [d.as_json() for d in diagnostics]}
    print_rows(rows, form, ("file", "kind", "name"), full=whole)
    kinds = Counter(m.kind.lower() for m in imported.manifests)
    told = [d.severity for d in imported.diagnostics]
    counts = [counted(n, kind) for kind, n in kinds.items()]
    counts += [counted(told.count(word), word) for word in ("warning", "note") if word in told]
    note(f"{output}: {', '.join(counts)}")
    for error in errors if form not in ("json", "yaml") else ():
        note(line(error.as_json()))
    if errors:
        note(f"the files are written; correct them, then `rorg validate {output}`")
        refuse(len(errors))
    warnings = f", with {counted(len(diagnostics), 'warning')} (`rorg validate {output}`)" if diagnostics else ""
    note(f"valid{warnings}\nnext: rorg {then} {output}")


def _whole(imported: Imported, output: Path | None) -> dict[str, Any]:
    """Everything, for programs. If nothing is written, `files` is empty."""
    return {
        "files": sorted(str(output / path) for path in imported.texts) if output else [],
        "manifests": [{"kind": m.kind, "name": m.name, "file": m.path} for m in imported.manifests],
        "diagnostics": [d.as_json() for d in imported.diagnostics],
    }
