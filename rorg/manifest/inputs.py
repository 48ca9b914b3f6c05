"""The files that a tree depends on besides its manifests: files that are read for it, and files that are mounted from
it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rorg.manifest.container import ContainerOptions
from rorg.manifest.container_files import parameter_files, seccomp_file
from rorg.manifest.documents import Source
from rorg.manifest.files import real
from rorg.manifest.long_forms import read_env_files
from rorg.manifest.profiles import declared
from rorg.manifest.programs import missing
from rorg.model.volumes import read_mount


@dataclass(frozen=True)
class Inputs:
    """Paths, existing or not: a missing file may appear later."""

    files: frozenset[Path] = frozenset()
    """Files read with the manifests: env_file, seccomp profiles, values of ROS parameters, Dockerfiles; and missing
    programs, working directories and mounts."""
    mounted: frozenset[Path] = frozenset()
    """Files and directories of the tree that services mount read-only. What they may write belongs to them."""
    contexts: frozenset[Path] = frozenset()
    """Build contexts of images, anywhere."""


def inputs(root: Path, by_kind: Mapping[str, Mapping[str, Source]]) -> Inputs:
    """The inputs of all services and images, including what any profile may add to a service."""
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


def _sources(options: ContainerOptions | None) -> Iterator[str]:
    """Host paths that a container mounts read-only."""
    for mount in map(read_mount, declared(options).get("volumes", ())):
        if mount.read_only and mount.source.startswith((".", "/")):
            yield mount.source
