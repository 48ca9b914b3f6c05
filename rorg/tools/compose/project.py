"""A Compose project as a value: all its files merged, filled in and converted into one form.

A section maps names to trees of plain values (dict, list, str, int, float, bool, None) with Compose's keys, but only
those that a file sets. Short forms are expanded. Per service:

| key | form |
|---|---|
| command, entrypoint, build.entitlements, dns, dns_search, tmpfs, cap_add, security_opt, ... | list of str |
| environment, labels, annotations, sysctls, build.args, build.labels, build.additional_contexts | {name: str}; of |
| | environment and build.args None for a bare name that is not set; environment includes the env files already |
| env_file | [{path: absolute, required: bool, format?: str}], kept to show where values came from |
| depends_on | {service: {condition: service_started, service_healthy or service_completed_successfully, |
| | required: bool, restart?: bool}}; without what Compose adds for links, volumes_from and network_mode |
| networks | {network: {aliases?, ipv4_address?, ...}}; {default: {}} without networks and network_mode |
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
| develop, credential_spec | as written, with types checked |

Everywhere: amounts of memory and rates are int, in bytes; durations are float, in seconds; paths of this machine are
absolute; `$$` is `$`; `x-` keys are kept as written. Networks and volumes of the top: {name: the engine's name,
driver?, driver_opts?: {name: str}, labels?, external?: bool, ipam?, internal?, attachable?, enable_ipv6?}; configs and
secrets: {name, file?: absolute, environment?, VALUE?: the value of that variable, content?, external?}. `networks` has
`default` if a service is in it.

These are the forms of `docker compose config --format json` of Compose 2.26, except for units, `$$`, `env_file`, and
services and resources that are not enabled, which that command leaves out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rorg.model.diagnostics import Diagnostic, Where

Place = tuple[str | int, ...]
"""A path in a project: ("services", "nav", "environment", "MAP"), ("services", "nav", "ports", 0, "target")."""
VALUE = "x-#value"
"""Key for the value of the variable in `environment` of a config or secret: included files have their own variables."""


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable that was filled in. `value`: None if it is not set. `file`: the env file that sets it; None if it
    comes from the process's environment, or is not set."""

    name: str
    value: str | None
    file: Where | None = None


@dataclass(frozen=True, slots=True)
class Project:
    """A set of Compose files. All mappings are in the order of the files, and must not be changed."""

    name: str
    directory: Path
    """Absolute base of relative paths in the first file."""
    services: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """All services of all profiles."""
    networks: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    volumes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    configs: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    secrets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    models: Mapping[str, Any] = field(default_factory=dict)
    """As written."""
    extensions: Mapping[str, Any] = field(default_factory=dict)
    """`x-` keys of the top."""
    enabled: frozenset[str] = frozenset()
    """Services that `docker compose up` would run with the given profiles."""
    profiles: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Service -> its profiles, if it has any."""
    files: tuple[Path, ...] = ()
    """All files that were read: Compose files, those of extends and include, env files, files of labels."""
    places: Mapping[Place, Where] = field(default_factory=dict)
    """The place of each key of a mapping and each item of a list. What the reader adds (default networks, names) has no
    place."""
    taken: Mapping[Place, tuple[str, ...]] = field(default_factory=dict)
    """The variables filled in in each value. A bare name in environment or build.args takes the variable of its
    name."""
    variables: Mapping[str, Variable] = field(default_factory=dict)
    """All variables in `taken`."""

    def where(self, *path: str | int) -> Where:
        """The place of a value, or of the nearest enclosing one."""
        for length in range(len(path), 0, -1):
            if path[:length] in self.places:
                return self.places[path[:length]]
        return Where(str(self.files[0])) if self.files else Where(str(self.directory))


@dataclass(frozen=True, slots=True)
class Loaded:
    """The result of reading: there is no project if a diagnostic is an error."""

    project: Project | None
    diagnostics: tuple[Diagnostic, ...] = ()
    """All errors and warnings, in the order of files and lines."""

    @property
    def errors(self) -> tuple[Diagnostic, ...]:
        return tuple(d for d in self.diagnostics if d.severity == "error")
