"""The container of one service as one mapping: its profile, its own options, and the files that they name."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Generator, Mapping
from functools import reduce
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from rorg.manifest.container import ContainerOptions
from rorg.manifest.container_files import env_files, seccomp_sent
from rorg.manifest.documents import Source
from rorg.manifest.driver import options_of
from rorg.manifest.files import real
from rorg.manifest.option_checks import FINAL
from rorg.manifest.profiles import Merged, Origin, Origins, declared, merge_options, origins_of
from rorg.manifest.programs import for_engine
from rorg.manifest.ros2 import environment_of, with_arguments
from rorg.manifest.together import Clash, clashes
from rorg.model.diagnostics import Diagnostic, Reading, collected, nearest
from rorg.model.run_directory import RUN, socket_folder
from rorg.model.volumes import mounted_at

CALLS = ("may_request", "may_manage", "may_act_for", "may_report_graph")
"""Permissions that give a service rorg's socket."""


def container_of(
    source: Source, profile: Merged, engine: str
) -> Reading[tuple[dict[str, Any], Origins, tuple[str, ...]]]:
    """Returns the options, the origin of each, and the names of secret variables."""
    spec: Any = source.spec
    options = substitute(dict(profile.container), values_of(source))
    added = yield from parts(source, profile)
    options = reduce(merge_options, (over for over, _ in added), options)
    own = [(Origin(part, profile=False), over) for over, part in added]
    origins = origins_of(options, [*profile.layers, *own])
    doubtful = source.partial or profile.partial
    options = yield from _without(source, options, doubtful)
    written = dict(options)

    def placed(problem: Clash | Diagnostic) -> Diagnostic:
        return _as_diagnostic(source, written, origins, problem) if isinstance(problem, Clash) else problem

    of_files, wrong = collected(_with_files(source, options))
    yield from map(placed, wrong)
    yield from _check(source, options, origins, doubtful)
    options = for_engine(source, options, engine)
    options["image"] = spec.image
    if spec.command is not None:
        options["command"] = list(spec.command)
    yield from with_arguments(source, options)
    secrets = {*of_files, *(n for n in spec.secrets if n in options.get("environment", {}))}
    return options, origins, tuple(sorted(secrets))


def _with_files(source: Source, options: dict[str, Any]) -> Generator[Clash | Diagnostic, None, set[str]]:
    """Puts what is in files in the place of their names; returns the variables that come only from files."""
    of_files: dict[str, str] = {}
    said: dict[str, str] = options.get("environment", {})
    if "volumes" in options:
        options["volumes"] = [absolute(v, source.directory) for v in options["volumes"]]
    if "env_file" in options:
        of_files = yield from env_files(source, options)
        options["environment"] = {**of_files, **said}
        del options["env_file"]
    if "security_opt" in options:
        options["security_opt"] = yield from seccomp_sent(source, options["security_opt"])
    return of_files.keys() - said.keys()


def _without(source: Source, options: dict[str, Any], doubtful: bool) -> Reading[dict[str, Any]]:
    """The options without the variables of the profile that the manifest unsets."""
    spec, known = cast(Any, source.spec), options.get("environment", {})
    own = declared(spec.container).get("environment", {})
    for index, name in enumerate(spec.unset_environment):
        where = source.where("spec", "unset_environment", index)
        if name in own:
            yield Diagnostic(where, f"'{name}' is both set and unset", "one of them")
        elif name not in known and not doubtful:
            yield Diagnostic(where, f"no profile of it gives '{name}'", nearest(name, known) or "to leave it out")
    kept = {k: v for k, v in known.items() if k not in spec.unset_environment}
    return {**options, "environment": kept} if spec.unset_environment else options


def parts(source: Source, profile: Merged) -> Reading[list[tuple[dict[str, Any], str]]]:
    """Returns the options that the manifest adds to its profile, with the name of the part that adds them."""
    spec: Any = source.spec
    additions = [(options_of(spec.driver, profile.without_hardware), "driver")] if spec.driver else []
    own = declared(spec.container)
    volumes = yield from _mounts(source)
    mounts = [m for m in volumes if m not in own.get("volumes", ())]
    if mounts:  # not merged: a volume of this manifest at the same target is a mistake
        own = {**own, "volumes": own.get("volumes", []) + mounts}
    additions.append((own, "this manifest"))
    if spec.ros and (variables := environment_of(spec.ros)):
        additions.append(({"environment": variables}, "ros"))
    if any(getattr(spec, permission) for permission in CALLS):
        folder = socket_folder(source.name)
        # The directory, not the socket: after a restart of rorg, a mounted socket is dead.
        socket = {"RORG_SOCKET": f"{folder}/rorg.sock"}
        additions.append(({"volumes": [f"{folder}:{folder}:ro"], "environment": socket}, CALLS[0]))
    return additions


def values_of(source: Source) -> dict[str, str]:
    """Values for the placeholders of a profile, for one service."""
    resources = source.spec.resources
    return {
        "${service}": source.name,
        "${resources.cpu}": f"{resources.cpu:g}",
        "${resources.memory}": str(resources.memory),
    }


def substitute(value: Any, values: Mapping[str, str]) -> Any:
    """Fills in the placeholders of a profile."""
    if isinstance(value, str):
        return re.sub(r"\$\{[a-z.]+\}", lambda m: values.get(m[0], m[0]), value)
    if isinstance(value, dict):
        return {k: substitute(v, values) for k, v in value.items()}
    return [substitute(v, values) for v in value] if isinstance(value, list) else value


def _mounts(source: Source) -> Reading[list[str]]:
    volumes = []
    for index, mount in enumerate(source.spec.mounts or ()):
        where = source.where("spec", "mounts", index)
        local, _, target = mount.partition(":")
        if not target.startswith("/") or ":" in target or not local or local.startswith("/"):
            yield Diagnostic(where, f"'{mount}' is not a mount", "./dir:/path/in/container")
        elif not os.path.exists(source.directory / local):
            message = f"'{local}' does not exist beside this manifest"
            yield Diagnostic(where, message, "to create it", code="missing-mount-source")
        else:
            volumes.append(f"{real(source.directory / local)}:{target}:ro")
    return volumes


def absolute(volume: Any, directory: Path) -> Any:
    """Makes paths that begin with `./`, `../` or `~/` absolute, relative to the manifest; other sources are volumes."""
    if isinstance(volume, dict):
        if volume["type"] == "bind" and not volume["source"].startswith("/"):
            return {**volume, "source": str(real(directory / os.path.expanduser(volume["source"])))}
        return volume
    head, colon, tail = volume.partition(":")
    if head.startswith("~/"):
        head = os.path.expanduser(head)
    elif head.startswith((".", "/")) and colon:
        head = str(real(directory / head)) if head.startswith(".") else head
    return head + colon + tail


def _check(source: Source, options: dict[str, Any], origins: Origins, doubtful: bool) -> list[Diagnostic]:
    """Checks that need profile and manifest together. `doubtful`: options may be missing because of mistakes."""
    late = {k: v for k, v in options.items() if k != "healthcheck" and "${" in json.dumps(v).replace(RUN, "/run/rorg")}
    if "volumes" in late:
        late["volumes"] = [v for v in late["volumes"] if not str(v).startswith(RUN)]
    try:
        ContainerOptions.model_validate(late, context=FINAL)
        problems = [clash for clash in clashes(options) if not (doubtful and clash.lacks)]
    except ValidationError as error:
        problems = [Clash(entry["loc"], entry["msg"].removeprefix("Value error, ")) for entry in error.errors()]
    return [_as_diagnostic(source, options, origins, clash) for clash in problems]


def _as_diagnostic(source: Source, options: dict[str, Any], origins: Origins, clash: Clash) -> Diagnostic:
    """Places a clash: at its line in the manifest, or at the name of the profile that brought it."""
    option, below = str(clash.path[0]), clash.path[1:]
    spec: Any = source.spec
    own, ours = declared(spec.container), False
    if option == "volumes" and below:  # the profile's volumes come first in the list
        place = mounted_at(options["volumes"][below[0]])
        below = tuple(i for i, volume in enumerate(own.get("volumes", ())) if mounted_at(volume) == place)[-1:]
    elif isinstance(options.get(option), list) and below:
        item = options[option][below[0]]
        below = tuple(index for index, said in enumerate(own.get(option, ())) if said == item)[:1]
        ours, option = bool(below), option if below else ""
    names = [name for name in origins.get(clash.other or str(clash.path[0]), ()) if name.profile or clash.other]
    by = f", which {names[-1]} declares" if names and names[-1].profile and not ours else ""
    where = source.where("spec", "container", option, *below) if option in own else source.where("spec", "profile")
    return Diagnostic(where, clash.message + by, clash.remedy, code=clash.code)
