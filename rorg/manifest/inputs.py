"""Which files besides the manifests a tree is made of: what was read for it, and what is mounted from it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rorg.manifest.container_files import seccomp_file
from rorg.manifest.documents import Source
from rorg.manifest.files import real
from rorg.manifest.long_forms import read_env_files
from rorg.manifest.programs import missing
from rorg.manifest.ros_parameters import parameter_files


@dataclass(frozen=True)
class Inputs:
    """Paths, whether anything is there or not: what is missing may come."""

    files: frozenset[Path] = frozenset()
    """Read with the manifests: env_file, profiles of seccomp, values of ROS parameters, Dockerfiles; and programs and
    their directories, and what is to be mounted, that are missing."""
    mounted: frozenset[Path] = frozenset()
    """Files and directories of the tree that services mount to read. What they may write is their own."""
    contexts: frozenset[Path] = frozenset()
    """Directories that images are built from, wherever they are."""


def inputs(root: Path, by_kind: Mapping[str, Mapping[str, Source]]) -> Inputs:
    """Those of all services and images, with what any profile may add to a service."""
    files: set[Path] = set()
    mounted: set[Path] = set()
    contexts: set[Path] = set()
    profiles = [s.spec.container for s in by_kind.get("Profile", {}).values()]
    for source in by_kind.get("Service", {}).values():
        spec: Any = source.spec
        files |= {*missing(source), *parameter_files(source)}
        for options in (spec.container, *profiles):
            files |= {source.directory / f.path for f in read_env_files(getattr(options, "env_file", None))}
            words = getattr(options, "security_opt", None) or ()
            files |= {source.directory / name for word in words if (name := seccomp_file(word))}
            mounted |= {source.directory / path for path in _sources(options)}
        mounts = {m: source.directory / m.partition(":")[0] for m in spec.mounts or ()}
        files |= {path for path in mounts.values() if not os.path.exists(path)}
        mounted |= {path for mount, path in mounts.items() if not mount.endswith(":rw")}
    for source in by_kind.get("Image", {}).values():
        image: Any = source.spec
        if image.context is not None:
            files.add(source.directory / image.context / image.dockerfile)
            contexts.add(real(source.directory / image.context))
    top = real(root)
    inside = frozenset(p for path in mounted if (p := real(path)).is_relative_to(top))
    return Inputs(frozenset(files), inside, frozenset(contexts))


def _sources(options: Any) -> Iterator[str]:
    """Paths on the host of what a container mounts to read."""
    for volume in getattr(options, "volumes", None) or ():
        source: str | None
        if isinstance(volume, str):
            source, _, rest = volume.partition(":")
            reads = "ro" in rest.partition(":")[2].split(",")
        else:
            source, reads = getattr(volume, "source", None), bool(getattr(volume, "read_only", False))
        if reads and source and source.startswith((".", "/")):
            yield source
