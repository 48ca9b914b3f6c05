"""Files that a manifest names and whose content is what counts: variables, seccomp profiles, ROS parameters."""

from __future__ import annotations

import errno
import json
import os
import re
from collections.abc import Generator, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rorg.manifest.documents import Source
from rorg.manifest.dotenv import read_dotenv, values_of
from rorg.manifest.files import read_plain, read_text
from rorg.manifest.long_forms import EnvFile, read_env_files
from rorg.manifest.ros import FILE as PARAMETER_FILE
from rorg.manifest.ros import Ros, file_of, sendable
from rorg.manifest.together import Clash
from rorg.manifest.variables import FILE
from rorg.model.diagnostics import Diagnostic, Reading, Where
from rorg.model.ros import RosParameters

NO_FILES = ("unconfined", "builtin")
"""Built-in seccomp profiles of the engine."""


def seccomp_file(value: str) -> str:
    """The file that a value of security_opt names; empty if it names none."""
    match = re.fullmatch(r"seccomp[=:](.+)", value, re.DOTALL)
    return match[1] if match and match[1] not in NO_FILES else ""


def seccomp_sent(source: Source, values: list[str]) -> Generator[Clash, None, list[str]]:
    """Replaces names of seccomp profiles by their content: the engine may be on another machine, and the digest must
    depend on the content."""
    sent = []
    for index, value in enumerate(values):
        if name := seccomp_file(value):
            try:
                profile = json.loads(read_text(source.directory / name, source.root))
            except (OSError, ValueError, RecursionError) as error:
                why = getattr(error, "strerror", None) or "not JSON"
                yield Clash(("security_opt", index), f"seccomp profile '{name}': {why}", "to create it")
                continue
            value = f"seccomp={json.dumps(profile, separators=(',', ':'))}"
        sent.append(value)
    return sent


def env_files(source: Source, options: Mapping[str, Any]) -> Generator[Clash | Diagnostic, None, dict[str, str]]:
    """Returns the variables of all files in `env_file`; later files win. Yields errors in the option and in files."""
    variables: dict[str, str] = {}
    for index, file in enumerate(read_env_files(options["env_file"])):
        try:
            variables |= yield from variables_of(source, file, variables)
        except OSError as error:
            missing = error.errno == errno.ENOENT
            if file.required or not missing:
                remedy = "to create it" if missing else "to fix it"
                yield Clash(("env_file", index), f"env_file '{file.path}': {error.strerror}", remedy)
    return variables


def variables_of(
    source: Source, file: EnvFile, before: Mapping[str, str] = MappingProxyType({})
) -> Reading[dict[str, str]]:
    """Returns the variables of one file. As in Compose, values may use variables of the tree's
    robot.env, of files `before` it and of earlier lines. Raises OSError if the file cannot be read."""
    text = read_plain(source.directory / file.path, source.root)
    if file.format == "raw":
        lines = (line for line in text.splitlines() if "=" in line and not line.lstrip().startswith("#"))
        return dict(line.split("=", 1) for line in lines)
    known = {**source.variables.values, **before}
    entries, mistakes = read_dotenv(text, known.get)
    place = str(Path(os.path.normpath(source.directory / file.path)))
    yield from (Diagnostic(Where(place, m.line, m.column), m.message, m.remedy) for m in mistakes)
    for entry in entries:
        where = Where(place, entry.line, entry.column)
        if entry.value is None:
            message = f"'{entry.name}' has no value and is left out, as no {FILE} declares it"
            yield Diagnostic(where, message, f"{entry.name}=value", "warning")
        for name in entry.unset:
            message = f"'{name}', which the value of {entry.name} names, is set nowhere and counts as empty"
            remedy = f"{name}=value in {FILE}, or single quotes for a dollar sign of its own"
            yield Diagnostic(where, message, remedy, "warning")
    return values_of(entries)


def parameter_files(source: Source) -> Iterator[Path]:
    """All files that the parameters of a Service are read from."""
    ros: Ros | None = source.spec.ros
    for value in ros.parameters.values() if ros else ():
        if path := file_of(value):
            yield source.directory / path


def parameters_of(source: Source, graph: str) -> Reading[RosParameters | None]:
    """Returns the parameters with the contents of files. `graph` is the name of the service's ROS graph."""
    ros: Ros | None = source.spec.ros
    if ros is None or not ros.parameters:
        return None
    values = {}
    for name, value in ros.parameters.items():
        path = file_of(value)
        try:
            values[name] = sendable(read_plain(source.directory / path, source.root)) if path else value
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or str(error)
            where = source.where("spec", "ros", "parameters", name, PARAMETER_FILE)
            yield Diagnostic(where, f"'{path}', the value of {name}: {why}", "to create or fix it")
    return RosParameters(graph, values)
