"""Checks and options that depend on the engine: a service as a process of this machine, or as a container.

Manifests do not name their engine. The caller that knows it (the loop, `rorg validate --engine`) passes it in;
otherwise only the checks for all engines run.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from rorg.manifest.documents import Source
from rorg.manifest.files import real
from rorg.model.catalog import Service
from rorg.model.diagnostics import Diagnostic
from rorg.model.engines import ENGINES
from rorg.model.image_names import declared
from rorg.model.joining import SERVICE

HOST = "host"
"""The image of services that run as processes of this machine, as `rorg import systemd` writes it. The process engine
ignores images."""


def in_containers(engine: str) -> bool:
    """Whether rorg knows the engine, and its programs run in containers with files of their own."""
    return engine in ENGINES and ENGINES[engine].isolation


def of_this_machine(engine: str) -> bool:
    """Whether rorg knows the engine, and its programs are plain processes with the files of this machine."""
    return engine in ENGINES and not ENGINES[engine].isolation


def for_engine(source: Source, options: Mapping[str, Any], engine: str) -> dict[str, Any]:
    """The options of a service for its engine. Without `working_dir`, a process starts in its manifest's directory;
    paths that begin with `./`, `../` or `~/` are relative to it too."""
    engine_options = dict(options)
    folder = engine_options.get("working_dir", "." if of_this_machine(engine) else None)
    if folder is not None and not in_containers(engine):
        engine_options["working_dir"] = str(real(source.directory / os.path.expanduser(folder)))
    if source.spec.inherit_environment is not None and not in_containers(engine):
        engine_options["inherit_environment"] = list(source.spec.inherit_environment)
    return engine_options


def check_programs(
    services: Mapping[str, Service], sources: Mapping[str, Source], images: Collection[str], engine: str
) -> list[Diagnostic]:
    """Reports what cannot work on this engine. A missing file inside the tree is an error. A missing file outside is a
    warning, because another machine may have it. No checks run for an unknown engine."""
    diagnostics: list[Diagnostic] = []
    for name, source in sources.items():
        spec = services[name].spec
        if spec is not None and in_containers(engine):
            diagnostics += _as_container(source, spec)
        elif spec is not None and of_this_machine(engine):
            diagnostics += _as_process(source, spec, images)
            diagnostics += _ignored_by_processes(source)
    return diagnostics


def missing(source: Source) -> set[Path]:
    """Missing files that a service names beside its manifest; the tree changes when they appear."""
    spec: Any = source.spec
    folder = source.directory / os.path.expanduser(getattr(spec.container, "working_dir", None) or ".")
    words = [*(getattr(spec.container, "entrypoint", None) or ()), *(spec.command or ())]
    named = {folder} | ({folder / words[0]} if words and "/" in words[0] else set())
    return {path for path in named if not os.path.exists(path)}


def _as_container(source: Source, spec: Mapping[str, Any]) -> Iterator[Diagnostic]:
    if source.spec.inherit_environment is not None:
        message = "the docker engine ignores inherit_environment: a container has its own environment"
        where = source.where("spec", "inherit_environment")
        yield Diagnostic(where, message, "container.environment or container.env_file", "warning")
    folder = spec.get("working_dir", "/")
    if not folder.startswith("/"):
        message = f"'{folder}' is a directory of this machine, and the docker engine needs one of the container"
        where = source.where("spec", "container", "working_dir")
        yield Diagnostic(where, message, "an absolute path, with a volume or a mount there")


def _as_process(source: Source, spec: Mapping[str, Any], images: Collection[str]) -> Iterator[Diagnostic]:
    folder = spec["working_dir"]
    words = [*spec.get("entrypoint", []), *spec.get("command", [])]
    where = source.where("spec", "command")
    search = spec.get("environment", {}).get("PATH") or os.environ.get("PATH", os.defpath)
    if not os.path.isdir(folder):
        where = source.where("spec", "container", "working_dir")
        yield Diagnostic(where, f"no directory {folder}", "to create it", _severity(source, folder))
    elif not words:
        yield Diagnostic(where, "no command, and a process has none from its image", "`command`", "warning")
    elif "/" in words[0]:
        path = os.path.normpath(os.path.join(folder, words[0]))
        if not os.path.isfile(path):
            yield Diagnostic(where, f"no program {path}", "to create it", _severity(source, path))
        elif not os.access(path, os.X_OK):
            yield Diagnostic(where, f"{path} is not executable", f"chmod +x {path}", "warning")
    elif not declared(spec["image"], images) and not shutil.which(words[0], path=search):
        remedy = f"to install it, or write ./{words[0]} for a program beside the manifest"
        yield Diagnostic(where, f"no program '{words[0]}' on this machine", remedy, "warning")


def _ignored_by_processes(source: Source) -> Iterator[Diagnostic]:
    """Reports what only a container can have, where the manifest itself declares it: the files and the network of a
    process are those of this machine. So `network_mode: host`, or the network of another service, is what it has."""
    spec: Any = source.spec
    container = spec.container
    mounted: list[tuple[str, ...]] = [("spec", "mounts")] if spec.mounts else []
    mounted += [("spec", "container", "volumes")] if container and container.volumes else []
    for path in mounted:
        message = f"the process engine ignores {path[-1]}: a process sees the files of this machine"
        yield Diagnostic(source.where(*path, key=True), message, "paths of this machine in the command", "warning")
    mode = str((container and container.network_mode) or "host")
    if mode != "host" and not mode.startswith(SERVICE):
        message = f"the process engine ignores network_mode: {mode}: a process uses the network of this machine"
        yield Diagnostic(source.where("spec", "container", "network_mode"), message, "network_mode: host", "warning")


def _severity(source: Source, path: str) -> str:
    inside = real(path).is_relative_to(real(source.root))
    return "error" if inside else "warning"
