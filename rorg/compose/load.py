"""From Compose files to a project, or all that is wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from rorg.compose.project import Loaded

Read = Callable[[Path], str]
"""The text of a file; OSError or UnicodeDecodeError where there is none."""


def load(
    paths: Sequence[Path],
    environment: Mapping[str, str],
    read: Read = Path.read_text,
    *,
    directory: Path | None = None,
    env_files: Sequence[Path] | None = None,
    profiles: Sequence[str] = (),
    name: str | None = None,
) -> Loaded:
    """The project that files say together, later ones over earlier ones.

    `paths`: one directory stands for the compose.yaml in it (or compose.yml, docker-compose.yaml, docker-compose.yml),
    with its compose.override.yaml. `environment`: of the process, which comes before `env_files` (default: `.env` in
    the project's directory, if it is there). `directory`: where relative paths begin, by default that of the first
    file. `profiles`: those that are enabled; "*" is all. `name`: of the project; else COMPOSE_PROJECT_NAME, `name:` of
    the files, or the name of the directory.
    """
    raise NotImplementedError
