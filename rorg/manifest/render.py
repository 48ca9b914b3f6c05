"""From one Service manifest and its profile to the service that is decided about, with its container rendered."""

from __future__ import annotations

import errno
import json
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from rorg.manifest.container import ContainerOptions
from rorg.manifest.documents import Source
from rorg.manifest.driver import hardware, options_of
from rorg.manifest.files import read_plain, read_text, real
from rorg.manifest.option_checks import FINAL
from rorg.manifest.probes import FORMS
from rorg.manifest.profiles import SHIPPED, Merged, Origin, Origins, declared, merge_options, trace
from rorg.manifest.programs import for_engine
from rorg.manifest.together import Clash, clashes
from rorg.model.catalog import RUN, Idle, Probe, Service, Updating
from rorg.model.diagnostics import Diagnostic
from rorg.model.volumes import mounted_at

ROS_MASTER = "http://localhost:11311"
"""Where ROS 1 looks for its master when ROS_MASTER_URI is not set."""


INTERVALS = {"ready": 0.25, "live": 10.0, "interlock": 0.25}
"""Seconds between two probes, where the manifest does not say. An exec costs the engine 50 ms, so it waits longer."""
EXEC_INTERVAL = 1.0


def render(source: Source, profile: Merged, policy: Any, engine: str = "") -> tuple[Service, list[Diagnostic]]:
    """The service of a manifest. `profile` already stands on `common`; `policy` is the Policy's spec, or None; `engine`
    the name of what is to run it, where that is known."""
    spec: Any = source.spec
    diagnostics, meta = list[Diagnostic](), spec.type == "meta"
    needs = list(spec.needs) + [n for n in profile.needs if n.service != source.name and not meta]
    container, origins, secrets = ({}, {}, ()) if meta else _container(source, profile, diagnostics, engine)
    protected, interlock = _guard(spec, policy)
    master = container.get("environment", {}).get("ROS_MASTER_URI", ROS_MASTER)
    service = Service(
        name=source.name,
        meta=meta,
        always_on=spec.always_on,
        needs=tuple(dict.fromkeys(n.service for n in needs)),
        restarts_with=tuple(sorted({n.service for n in needs if n.restart})),
        conflicts=tuple(spec.conflicts),
        exclusive=dict(spec.exclusive),
        may_request=tuple(spec.may_request),
        may_restart=tuple(spec.may_restart),
        may_act_for=tuple(spec.may_act_for),
        may_manage=tuple(spec.may_manage),
        idle=_idle(spec, profile, policy),
        update=_updating(spec, policy),
        ready=None if meta else probe(spec.ready or profile.ready, "ready", master),
        live=None if meta else probe(spec.live or profile.live, "live", master),
        interlock=None if meta else probe(interlock, "interlock", master),
        protected=protected,
        restart=spec.restart or profile.restart or "always",
        on_change=spec.on_change,
        priority=spec.priority,
        cpu=spec.resources.cpu,
        memory=spec.resources.memory,
        **hardware(spec.driver, profile.without_hardware),
        spec=None if meta else container,
        secrets=secrets,
        defaults=tuple(sorted(path for path, names in origins.items() if names == (SHIPPED,))),
        origins={path: ", ".join(map(str, names)) for path, names in sorted(origins.items())},
        description=source.description,
        labels=source.labels,
        where=source.where("metadata", "name"),
    )
    return service, diagnostics


def _idle(spec: Any, profile: Merged, policy: Any) -> Idle:
    """The Policy's, with what the profile and then the manifest say otherwise."""
    first = policy.idle.model_dump(exclude_none=True) if policy and policy.idle else {}
    declared = {**first, **profile.idle, **(spec.idle.model_dump(exclude_none=True) if spec.idle else {})}
    escalate = declared.get("escalate")
    return Idle(**{**declared, "escalate": (escalate["after"], escalate["action"]) if escalate else None})


ALL = "*"
"""The set of those that say `atomic: true`; no set can be called so."""


def _guard(spec: Any, policy: Any) -> tuple[bool, Any]:
    """Whether it is protected, and what must allow that its container is touched."""
    driver = spec.driver is not None
    protected = driver if spec.protected is None else spec.protected
    return protected, spec.interlock or (policy.interlock if policy and (driver or protected) else None)


def _updating(spec: Any, policy: Any) -> Updating:
    """The Policy's, with what the manifest says otherwise."""
    first = policy.updates.model_dump() if policy and policy.updates else {}
    said = {**first, **(spec.update.model_dump(exclude_none=True) if spec.update else {})}
    atomic = said.pop("atomic", False)
    return Updating(**said, atomic=atomic if isinstance(atomic, str) else ALL if atomic else "")


def probe(model: Any, role: str, master: str = "") -> Probe | None:
    """A probe as the loop asks it; `role` is ready, live or interlock."""
    if model is None:
        return None
    kind = next(name for name in FORMS if getattr(model, name, None) is not None)
    target = getattr(model, kind)
    if kind == "tcp":
        host, _, port = str(target).rpartition(":")
        target = f"{host or '127.0.0.1'}:{port}"
    interval = model.interval
    if interval is None:
        interval = max(INTERVALS[role], EXEC_INTERVAL) if kind == "exec" else INTERVALS[role]
    return Probe(
        kind,
        tuple(target) if isinstance(target, list) else target,
        getattr(model, "timeout", 30.0),
        interval,
        getattr(model, "failures", None) or 0,
        master if kind.startswith("ros_") else "",
    )


def _container(
    source: Source, profile: Merged, diagnostics: list[Diagnostic], engine: str
) -> tuple[dict[str, Any], Origins, tuple[str, ...]]:
    """Its options, what declares each, and which of its variables are secret."""
    spec: Any = source.spec
    options = substitute(dict(profile.container), values_of(source))
    origins = profile.origins
    for over, part in parts(source, profile, diagnostics):
        options = merge_options(options, over)
        origins = trace(origins, options, over, Origin(part, profile=False))
    of_files: dict[str, str] = {}
    if "volumes" in options:
        options["volumes"] = [absolute(v, source.directory) for v in options["volumes"]]
    if "env_file" in options:
        said, of_files = options.get("environment", {}), _env_files(source, options, diagnostics)
        options["environment"] = {**of_files, **said}
        of_files = {k: v for k, v in of_files.items() if k not in said}
        del options["env_file"]
    if "security_opt" in options:
        options["security_opt"] = _security(source, options["security_opt"], diagnostics)
    diagnostics += _check(source, options, origins)
    options = for_engine(source, options, engine)
    options["image"] = spec.image
    if spec.command is not None:
        options["command"] = list(spec.command)
    return (
        options,
        origins,
        tuple(sorted({*of_files, *(n for n in spec.secrets if n in options.get("environment", {}))})),
    )


def parts(source: Source, profile: Merged, diagnostics: list[Diagnostic]) -> Iterator[tuple[dict[str, Any], str]]:
    """What the manifest itself puts on its profile, with the part of it that says so."""
    spec: Any = source.spec
    if spec.driver:
        yield options_of(spec.driver, profile.without_hardware), "driver"
    own = declared(spec.container)
    mounts = [m for m in _mounts(source, diagnostics) if m not in own.get("volumes", ())] if spec.mounts else []
    if mounts:  # not merged: a volume of this manifest at the same place is a mistake
        own = {**own, "volumes": own.get("volumes", []) + mounts}
    yield own, "this manifest"
    if spec.may_request or spec.may_manage or spec.may_act_for:
        folder = f"{RUN}/services/{source.name}"
        # The directory, never the socket: a mounted socket is dead for ever once rorg was restarted.
        socket = {"RORG_SOCKET": f"{folder}/rorg.sock"}
        yield {"volumes": [f"{folder}:{folder}:ro"], "environment": socket}, "may_request"


def values_of(source: Source) -> dict[str, str]:
    """What a profile may leave open, for one service."""
    resources = source.spec.resources
    return {
        "${service}": source.name,
        "${resources.cpu}": f"{resources.cpu:g}",
        "${resources.memory}": str(resources.memory),
    }


def substitute(value: Any, values: Mapping[str, str]) -> Any:
    """The same with what a profile left open filled in."""
    if isinstance(value, str):
        return re.sub(r"\$\{[a-z.]+\}", lambda m: values.get(m[0], m[0]), value)
    if isinstance(value, dict):
        return {k: substitute(v, values) for k, v in value.items()}
    return [substitute(v, values) for v in value] if isinstance(value, list) else value


def _mounts(source: Source, diagnostics: list[Diagnostic]) -> list[str]:
    volumes = []
    for index, mount in enumerate(source.spec.mounts):
        where = source.where("spec", "mounts", index)
        local, _, target = mount.partition(":")
        if not target.startswith("/") or ":" in target or not local or local.startswith("/"):
            diagnostics.append(Diagnostic(where, f"'{mount}' is not a mount", "./dir:/path/in/container"))
        elif not os.path.exists(source.directory / local):
            diagnostics.append(Diagnostic(where, f"'{local}' does not exist beside this manifest", "creating it"))
        else:
            volumes.append(f"{real(source.directory / local)}:{target}:ro")
    return volumes


def absolute(volume: Any, directory: Path) -> Any:
    """Sources that begin with `./`, `../` or `~/` are paths, relative to the manifest; others are volumes."""
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


def _security(source: Source, values: list[str], diagnostics: list[Diagnostic]) -> list[str]:
    """A profile of seccomp is sent, not named: the engine may be on another machine."""
    found = []
    for index, value in enumerate(values):
        kind, _, name = value.partition("=") if "=" in value else value.partition(":")
        if kind == "seccomp" and name not in ("unconfined", "builtin"):
            try:
                profile = json.loads(read_text(source.directory / name, source.root))
            except (OSError, ValueError, RecursionError) as error:
                where = source.where("spec", "container", "security_opt", index)
                why = getattr(error, "strerror", None) or "not JSON"
                diagnostics.append(Diagnostic(where, f"seccomp profile '{name}': {why}", "creating it"))
                continue
            value = f"seccomp={json.dumps(profile, separators=(',', ':'))}"
        found.append(value)
    return found


def _check(source: Source, options: dict[str, Any], origins: Origins) -> list[Diagnostic]:
    """What only shows when profile and manifest have come together."""
    late = {k: v for k, v in options.items() if k != "healthcheck" and "${" in json.dumps(v).replace(RUN, "/run/rorg")}
    if "volumes" in late:
        late["volumes"] = [v for v in late["volumes"] if not str(v).startswith(RUN)]
    try:
        ContainerOptions.model_validate(late, context=FINAL)
        found = clashes(options)
    except ValidationError as error:
        found = [Clash(entry["loc"], entry["msg"].removeprefix("Value error, ")) for entry in error.errors()]
    return [_as_diagnostic(source, options, origins, clash) for clash in found]


def _as_diagnostic(source: Source, options: dict[str, Any], origins: Origins, clash: Clash) -> Diagnostic:
    """At its place in the manifest, or where that names the profile which brought it."""
    option, below = clash.path[0], clash.path[1:]
    spec: Any = source.spec
    own = declared(spec.container)
    if option == "volumes" and below:  # the list began with the profile's
        place = mounted_at(options["volumes"][below[0]])
        below = tuple(i for i, volume in enumerate(own.get("volumes", ())) if mounted_at(volume) == place)[-1:]
    names = origins.get(clash.other or str(option), ())
    by = f", which {names[0]} declares" if names and names[0].profile else ""
    where = source.where("spec", "container", option, *below) if option in own else source.where("spec", "profile")
    return Diagnostic(where, clash.message + by, clash.remedy)


def _env_files(source: Source, options: dict[str, Any], diagnostics: list[Diagnostic]) -> dict[str, str]:
    found: dict[str, str] = {}
    for index, name in enumerate(options["env_file"]):
        try:
            lines = read_plain(source.directory / name, source.root).splitlines()
        except OSError as error:
            where = source.where("spec", "container", "env_file", index)
            remedy = "creating it" if error.errno == errno.ENOENT else "fixing it"
            diagnostics.append(Diagnostic(where, f"env_file '{name}': {error.strerror}", remedy))
            continue
        found |= dict(line.split("=", 1) for line in lines if "=" in line and not line.lstrip().startswith("#"))
    return found
