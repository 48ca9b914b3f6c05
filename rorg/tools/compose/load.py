"""Reads Compose files into a project, or reports everything that is wrong with them."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rorg.manifest.files import Reader
from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Where
from rorg.tools.compose.assemble import Assembler
from rorg.tools.compose.checks import check
from rorg.tools.compose.nodes import read_nodes
from rorg.tools.compose.normalise import normalised
from rorg.tools.compose.project import Loaded, Project
from rorg.tools.compose.variables import Files, Variables, fill

Read = Callable[[Path], str]
"""The text of a file. Raises OSError or UnicodeDecodeError."""
FILE_NAMES = ("compose.yaml", "compose.yml", "docker-compose.yaml", "docker-compose.yml")
NAME = "COMPOSE_PROJECT_NAME"
OVERRIDE_NAMES = tuple(name.replace("compose.", "compose.override.") for name in FILE_NAMES)


def load(
    paths: Sequence[Path],
    environment: Mapping[str, str],
    read: Read | None = None,
    *,
    directory: Path | None = None,
    env_files: Sequence[Path] | None = None,
    profiles: Sequence[str] = (),
    name: str | None = None,
) -> Loaded:
    """The project that these files make together, with later files over earlier ones.

    `paths`: files, or one directory with a compose.yaml (or compose.yml, docker-compose.yaml, docker-compose.yml) and
    perhaps a compose.override.yaml. `environment`: of the process; it takes precedence over `env_files`, which default
    to an existing `.env` in the project's directory. `read`: by default, a reader of the first file's folder and of
    the files named here (manifest/files.py). `directory`: base of relative paths, by default that of the first file.
    `profiles`: enabled profiles (by default those of COMPOSE_PROFILES); "*" means all. `name`: of the project; by
    default COMPOSE_PROJECT_NAME, `name:` of the files, or the name of the directory.
    """
    first = paths[0] if paths[0].is_dir() else paths[0].parent
    files = Files(read or Reader(directory or first, [*paths, *(env_files or ())]))
    try:
        project = _project(paths, environment, files, directory, env_files=env_files, profiles=profiles, name=name)
    except TooMuch as bound:
        files.diagnostics.append(bound.diagnostic)
        project = None
    diagnostics = tuple(sorted(set(files.diagnostics)))
    refused = any(d.severity == "error" for d in diagnostics)
    return Loaded(None if refused else project, diagnostics)


def _project(
    paths: Sequence[Path],
    environment: Mapping[str, str],
    files: Files,
    directory: Path | None,
    *,
    env_files: Sequence[Path] | None,
    profiles: Sequence[str],
    name: str | None,
) -> Project:
    assembler = Assembler(files, environment.get("HOME", ""))
    absolute_paths = [Path(os.path.abspath(path)) for path in _files(paths, files)]
    base = Path(os.path.abspath(directory)) if directory else absolute_paths[0].parent
    outside = dict(environment)
    variables = Variables(outside, spend=files.spend)
    if env_files is None and files.there(base / ".env"):
        env_files = [base / ".env"]
    for path in env_files or ():
        assembler.env_file(Path(os.path.abspath(path)), Where(str(path)), variables)
    known = name or variables.get(NAME) or _said_name(absolute_paths, files, variables) or project_name(base)
    outside[NAME] = known
    tree = assembler.tree(absolute_paths, base, variables, Where(str(absolute_paths[0])))
    if not re.fullmatch(r"[a-z0-9][a-z0-9_-]*", known):
        where = tree.mapping["name"].where if "name" in tree.mapping else Where(str(absolute_paths[0]))
        remedy = "lower-case letters, digits, - and _, starting with a letter or digit"
        files.error(where, f"'{known}' is not a valid name of a project", remedy)
    wanted = list(profiles) or [p for p in (variables.get("COMPOSE_PROFILES") or "").split(",") if p]
    project = normalised(tree, known, base, assembler, variables, wanted)
    files.diagnostics += check(project)
    return project


def _said_name(paths: Sequence[Path], files: Files, variables: Variables) -> str:
    """The last `name:` in the files. It is needed before they are read, because their variables may refer to it."""
    for path in reversed(paths):
        line = re.search(r"^name:.*$", files.texts.get(path) or "", re.MULTILINE) if files.there(path) else None
        documents = read_nodes(line[0], str(path))[0] if line else []
        for document in documents:
            value = fill(document, variables, []).mapping["name"].value
            if isinstance(value, str):
                return value
    return ""


def _files(paths: Sequence[Path], files: Files) -> list[Path]:
    """The Compose files of a directory, or the files themselves."""
    if len(paths) != 1 or not paths[0].is_dir():
        return list(paths)
    inside = paths[0]
    main = next((inside / name for name in FILE_NAMES if files.there(inside / name)), inside / FILE_NAMES[0])
    over = [inside / name for name in OVERRIDE_NAMES if files.there(inside / name)]
    return [main, *over[:1]]


def project_name(directory: Path) -> str:
    """The project name that Compose derives from a directory."""
    return re.sub(r"[^a-z0-9_-]", "", directory.name.lower()).lstrip("_-") or "default"
