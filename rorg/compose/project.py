"""A Compose project as a value: all its files merged, filled in and brought into one form.

A section is a mapping from names to trees of plain values (dict, list, str, int, float, bool, None), with Compose's
keys, of which only those are there that a file says. Short forms are gone. Per service:

| key | form |
|---|---|
| command, entrypoint, build.entitlements, dns, dns_search, tmpfs, cap_add, security_opt, ... | list of str |
| environment, labels, annotations, sysctls, build.args, build.labels, build.additional_contexts | {name: str}; of |
| | environment and build.args None for a bare name that nothing sets; env files are in environment already |
| env_file | [{path: absolute, required: bool, format?: str}], kept so that one can tell where values came from |
| depends_on | {service: {condition: service_started, service_healthy or service_completed_successfully, |
| | required: bool, restart?: bool}}; without what Compose adds for links, volumes_from and network_mode |
| networks | {network: {aliases?, ipv4_address?, ...}}; {default: {}} where nothing is said and no network_mode is |
| ports | [{target: int, published?: str, host_ip?: str, protocol: str, mode: str, name?, app_protocol?}] |
| volumes | [{type: bind, volume, tmpfs, npipe or cluster; source?, target, read_only?: bool, bind?, volume?, tmpfs?}] |
| devices | [{source, target, permissions}] |
| configs, secrets | [{source, target?, uid?, gid?, mode?: int}] |
| build | {context: absolute or URL, dockerfile: absolute or beside the context, args, target, ...} |
| ulimits | {name: int or {soft: int, hard: int}} |
| extra_hosts, build.extra_hosts | ["host=address", ...] |
| healthcheck.test | list of str that begins with CMD, CMD-SHELL or NONE |
| deploy.resources.{limits,reservations} | {cpus: float, memory: int, pids: int, devices: [{capabilities, driver?, |
| | count?, device_ids?, options?}]}; count is -1 for `all` |
| gpus | [{capabilities?, driver?, count?, device_ids?, options?}], as devices of deploy |
| blkio_config | {weight: int, weight_device: [{path, weight}], device_read_bps: [{path, rate: int}], ...} |
| logging | {driver?, options?: {name: str}} |
| develop, credential_spec | as they are written, with types checked |

Everywhere: amounts of memory and rates are int, in bytes; durations float, in seconds; paths of this machine absolute;
`$$` is `$`. `x-` keys are there as written. Networks and volumes of the top: {name: the engine's name, driver?,
driver_opts?: {name: str}, labels?, external?: bool, ipam?, internal?, attachable?, enable_ipv6?}; configs and secrets:
{name, file?: absolute, environment?, content?, external?}. `networks` has `default` where a service is in it.

These are the forms of `docker compose config --format json` of Compose 2.26, but for units, `$$`, `env_file`, and
services and resources that nothing enables, which that leaves out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rorg.model.diagnostics import Diagnostic, Where

Place = tuple[str | int, ...]
"""A path in a project: ("services", "nav", "environment", "MAP"), ("services", "nav", "ports", 0, "target")."""


@dataclass(frozen=True, slots=True)
class Variable:
    """One that was filled in. `value`: None where nothing sets it. `file`: the env file that sets it; None where it
    comes from the process's environment, or from nowhere."""

    name: str
    value: str | None
    file: Where | None = None


@dataclass(frozen=True, slots=True)
class Project:
    """Everything that a set of files says. All mappings are in the order of the files, and nobody changes them."""

    name: str
    directory: Path
    """Where relative paths of the first file begin; absolute."""
    services: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """All of them, whatever their profiles are."""
    networks: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    volumes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    configs: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    secrets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    extensions: Mapping[str, Any] = field(default_factory=dict)
    """`x-` keys of the top."""
    enabled: frozenset[str] = frozenset()
    """Services that `docker compose up` would run with the profiles that were given."""
    profiles: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Of each service that has any: their names."""
    files: tuple[Path, ...] = ()
    """All that were read: Compose files, those of extends and include, env files."""
    places: Mapping[Place, Where] = field(default_factory=dict)
    """Where each key of a mapping, and each item of a list, stands. Of what the reader adds (default networks, names)
    nothing is there."""
    taken: Mapping[Place, tuple[str, ...]] = field(default_factory=dict)
    """Which variables were filled in in a value. A bare name in environment or build.args takes the one of its name."""
    variables: Mapping[str, Variable] = field(default_factory=dict)
    """All that `taken` names."""

    def where(self, *path: str | int) -> Where:
        """The place of a value, or of the nearest one around it."""
        for length in range(len(path), 0, -1):
            if path[:length] in self.places:
                return self.places[path[:length]]
        return Where(str(self.files[0])) if self.files else Where(str(self.directory))


@dataclass(frozen=True, slots=True)
class Loaded:
    """What came of reading: a project only where no diagnostic is an error."""

    project: Project | None
    diagnostics: tuple[Diagnostic, ...] = ()
    """All of them, errors and warnings, in the order of files and lines."""

    @property
    def errors(self) -> tuple[Diagnostic, ...]:
        return tuple(d for d in self.diagnostics if d.severity == "error")
