"""Files that options of a container name, and whose content is what counts: variables, and profiles of seccomp."""

from __future__ import annotations

import errno
import json
import re
from collections.abc import Mapping
from typing import Any

from rorg.manifest.documents import Source
from rorg.manifest.files import read_plain, read_text
from rorg.manifest.long_forms import EnvFile, read_env_files
from rorg.manifest.together import Clash

NO_FILES = ("unconfined", "builtin")
"""Profiles of seccomp that the engine has."""


def seccomp_file(value: str) -> str:
    """The file that a value of security_opt names; empty for what names none."""
    found = re.fullmatch(r"seccomp[=:](.+)", value, re.DOTALL)
    return found[1] if found and found[1] not in NO_FILES else ""


def seccomp_sent(source: Source, values: list[str], found: list[Clash]) -> list[str]:
    """A profile of seccomp is sent, not named: the engine may be on another machine, and what it says is what counts
    for the digest."""
    sent = []
    for index, value in enumerate(values):
        if name := seccomp_file(value):
            try:
                profile = json.loads(read_text(source.directory / name, source.root))
            except (OSError, ValueError, RecursionError) as error:
                why = getattr(error, "strerror", None) or "not JSON"
                found.append(Clash(("security_opt", index), f"seccomp profile '{name}': {why}", "creating it"))
                continue
            value = f"seccomp={json.dumps(profile, separators=(',', ':'))}"
        sent.append(value)
    return sent


def env_files(source: Source, options: Mapping[str, Any], found: list[Clash]) -> dict[str, str]:
    """The variables of all files that `env_file` names; those of a later one win."""
    variables: dict[str, str] = {}
    for index, file in enumerate(read_env_files(options["env_file"])):
        try:
            variables |= variables_of(source, file)
        except OSError as error:
            missing = error.errno == errno.ENOENT
            if file.required or not missing:
                remedy = "creating it" if missing else "fixing it"
                found.append(Clash(("env_file", index), f"env_file '{file.path}': {error.strerror}", remedy))
    return variables


def variables_of(source: Source, file: EnvFile) -> dict[str, str]:
    """Those of one file. Raises OSError for one that cannot be read."""
    lines = read_plain(source.directory / file.path, source.root).splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line and not line.lstrip().startswith("#"))
