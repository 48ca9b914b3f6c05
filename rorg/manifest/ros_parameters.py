"""ROS parameters of a Service, with the contents of the files that they name."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rorg.manifest.documents import Source
from rorg.manifest.files import read_plain
from rorg.manifest.ros import FILE, Ros, file_of, sendable
from rorg.model.diagnostics import Diagnostic
from rorg.model.ros import RosParameters


def parameter_files(source: Source) -> Iterator[Path]:
    """All files that the parameters of a Service are read from."""
    ros: Ros | None = source.spec.ros
    for value in ros.parameters.values() if ros else ():
        if path := file_of(value):
            yield source.directory / path


def parameters_of(source: Source, master: str, found: list[Diagnostic]) -> RosParameters | None:
    """Returns the parameters with the contents of files. `master` is the URI of the service's ROS master; errors go to
    `found`."""
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
            where = source.where("spec", "ros", "parameters", name, FILE)
            found.append(Diagnostic(where, f"'{path}', the value of {name}: {why}", "creating or fixing it"))
    return RosParameters(master, values)
