"""Files of parameters for programs of ROS 2, which read them when they start: `--params-file` of their command."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rorg.model.catalog import Catalog
from rorg.model.ros import PARAMETER_FILE, parameter_file
from rorg.store.files import make_directory, write_atomic


class ParameterFiles:
    """One file per service, in a folder of its own that its container mounts. `tell` is called with what went
    wrong."""

    def __init__(self, run: Path, tell: Callable[[str], None]) -> None:
        """`run` is the directory of rorg's sockets."""
        self.folder, self.tell = run / "parameters", tell
        self._written: dict[str, Mapping[str, Any]] = {}

    def write(self, catalog: Catalog) -> None:
        """Write those that have changed since. A file that is no longer declared stays as long as rorg runs: an old
        container may still mount it."""
        for name, service in catalog.services.items():
            if service.ros is None or service.domain is None or self._written.get(name) == service.ros.values:
                continue
            try:
                make_directory(self.folder, 0o700)
                make_directory(self.folder / name, 0o755)
                # Programs in containers run as any user. Other users of this machine do not get as far as this folder.
                write_atomic(self.folder / name / PARAMETER_FILE, parameter_file(service.ros.values), mode=0o644)
            except OSError as error:
                self.tell(f"cannot write the ROS parameters of {name}: {error}")
            else:
                self._written[name] = service.ros.values
