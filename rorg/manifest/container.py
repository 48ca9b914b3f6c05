"""The `container:` section: every option of the engine's create call, under Compose's names.

Each field says what a change of it costs a running container, in `x-rorg-change`:
`live` (the engine updates it in place), or `recreate` (stop, remove, create, start).
"""

from __future__ import annotations

import re
import shlex
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from rorg.manifest.scalars import Duration, Memory


class Strict(BaseModel):
    """Unknown keys are errors, and no scalar is turned into another type."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def recreate(**extra: Any) -> Any:
    return Field(default=None, json_schema_extra={"x-rorg-change": "recreate"}, **extra)


def live(**extra: Any) -> Any:
    return Field(default=None, json_schema_extra={"x-rorg-change": "live"}, **extra)


def unchanging(default: Any = None, **extra: Any) -> Any:
    return Field(default=default, json_schema_extra={"x-rorg-change": "none"}, **extra)


def _words(value: object) -> object:
    try:
        return shlex.split(value) if isinstance(value, str) else value
    except ValueError as error:
        raise ValueError(f"not a command line: {error}") from error


def _one_or_many(value: object) -> object:
    return [value] if isinstance(value, str) else value


def _pairs(value: object) -> object:
    """`[K=V]` or `{K: V}` as {K: "V"}; numbers become text, as in Compose."""
    if isinstance(value, list):
        if not all(isinstance(item, str) and "=" in item for item in value):
            raise ValueError("each item must read KEY=VALUE")
        return dict(item.split("=", 1) for item in value)
    return value


def _text(value: object) -> object:
    if value is None:
        raise ValueError("a value is missing; write it, or '' for an empty one")
    if isinstance(value, bool):
        raise ValueError("true and false must be quoted here, as in Compose")
    return str(value) if isinstance(value, int | float) else value


def _texts(value: object) -> object:
    return [_text(item) for item in value] if isinstance(value, list) else value


def _volume(value: object) -> object:
    if isinstance(value, str) and not re.match(r"^(/[^:]*|[^:]+:/[^:]*(:[a-zA-Z,]+)?)$", value):
        raise ValueError(f"'{value}' is not a volume; write SOURCE:/path/in/container, with :ro for read only")
    return value


def _device(value: str) -> str:
    if not re.match(r"^[^:]+(:[^:]+(:[rwm]{1,3})?)?$", value) or not value.startswith("/"):
        raise ValueError(f"'{value}' is not a device; write /dev/NAME or /dev/NAME:/dev/NAME:rw")
    return value


def _signal(value: object) -> object:
    text = str(value).upper()
    if not re.match(r"^(SIG)?[A-Z0-9+]+$", text):
        raise ValueError(f"'{value}' is not a signal; write SIGINT or SIGTERM")
    return text if text.startswith("SIG") or text.isdigit() else f"SIG{text}"


Words = Annotated[list[str], BeforeValidator(_words)]
Many = Annotated[list[str], BeforeValidator(_one_or_many)]
Texts = Annotated[list[str], BeforeValidator(_texts)]
Text = Annotated[str, BeforeValidator(_text)]
def _not_ours(value: dict[str, str]) -> dict[str, str]:
    if any(name.startswith("rorg.io/") for name in value):
        raise ValueError("labels that begin with rorg.io/ are rorg's own")
    return value


Pairs = Annotated[dict[str, Text], BeforeValidator(_pairs)]
Labels = Annotated[Pairs, AfterValidator(_not_ours)]
Signal = Annotated[str, BeforeValidator(_signal)]
Cores = Annotated[float, Field(strict=False, gt=0)]
Device = Annotated[str, AfterValidator(_device)]


class Ulimit(Strict):
    soft: int
    hard: int


class Logging(Strict):
    driver: str = "json-file"
    options: Pairs = Field(default_factory=dict)


class Healthcheck(Strict):
    test: Annotated[list[str], BeforeValidator(lambda v: ["CMD-SHELL", v] if isinstance(v, str) else v)] | None = None
    interval: Duration | None = None
    timeout: Duration | None = None
    retries: int | None = None
    start_period: Duration | None = None
    disable: bool = False


class Mount(Strict):
    """Compose's long form of a volume."""

    type: Literal["bind", "volume", "tmpfs", "npipe"]
    source: str | None = None
    target: str
    read_only: bool = False
    consistency: str | None = None
    bind: dict[str, str | bool] | None = None
    volume: dict[str, str | bool] | None = None
    tmpfs: dict[str, int | str] | None = None


class Rate(Strict):
    path: str
    rate: int | str


class Weight(Strict):
    path: str
    weight: int


class BlkioConfig(Strict):
    weight: int | None = None
    weight_device: list[Weight] | None = None
    device_read_bps: list[Rate] | None = None
    device_write_bps: list[Rate] | None = None
    device_read_iops: list[Rate] | None = None
    device_write_iops: list[Rate] | None = None


class Gpu(Strict):
    driver: str | None = None
    count: int | Literal["all"] | None = None
    device_ids: list[str] | None = None
    capabilities: list[str] = Field(default_factory=lambda: ["gpu"])
    options: Pairs | None = None


class Network(Strict):
    aliases: list[str] | None = None
    ipv4_address: str | None = None
    ipv6_address: str | None = None
    link_local_ips: list[str] | None = None
    mac_address: str | None = None
    driver_opts: Pairs | None = None


def _networks(value: object) -> object:
    if isinstance(value, list):
        return {name: {} for name in value}
    return {k: v or {} for k, v in value.items()} if isinstance(value, dict) else value


def _ulimits(value: object) -> object:
    if isinstance(value, dict):
        return {k: {"soft": v, "hard": v} if type(v) is int else v for k, v in value.items()}
    return value


def _gpus(value: object) -> object:
    return [{"count": "all"}] if value == "all" else value


CONTAINER_NAME = r"^([a-zA-Z0-9]|\$\{service\})([a-zA-Z0-9_.-]|\$\{service\})*$"


class ContainerOptions(Strict):
    """Options of the container, named as in Compose. What rorg itself decides (image, command, restart of
    services) stands outside of this section."""

    annotations: Pairs | None = recreate()
    blkio_config: BlkioConfig | None = recreate()
    cap_add: list[str] | None = recreate()
    cap_drop: list[str] | None = recreate()
    cgroup: Literal["host", "private"] | None = recreate()
    cgroup_parent: str | None = recreate()
    container_name: Annotated[str, Field(pattern=CONTAINER_NAME)] | None = live(
        description="Name of the container; the service's name by default."
    )
    cpu_period: int | None = live()
    cpu_quota: int | None = live()
    cpu_rt_period: int | None = live()
    cpu_rt_runtime: int | None = live()
    cpu_shares: int | None = live()
    cpus: Cores | None = live(description="Limit of CPU, in cores.")
    cpuset: Text | None = live()
    cpuset_mems: Text | None = live()
    device_cgroup_rules: list[str] | None = recreate()
    devices: list[Device] | None = recreate()
    dns: Many | None = recreate()
    dns_opt: Many | None = recreate()
    dns_search: Many | None = recreate()
    domainname: str | None = recreate()
    entrypoint: Words | None = recreate()
    env_file: Many | None = recreate(description="Files of KEY=VALUE lines; `environment` wins over them.")
    environment: Pairs | None = recreate()
    expose: Texts | None = recreate()
    extra_hosts: Annotated[list[str], BeforeValidator(
        lambda v: [f"{k}:{a}" for k, a in v.items()] if isinstance(v, dict) else v)] | None = recreate()
    gpus: Annotated[list[Gpu], BeforeValidator(_gpus)] | None = recreate()
    group_add: Texts | None = recreate()
    healthcheck: Healthcheck | None = recreate()
    hostname: str | None = recreate()
    init: bool | None = recreate()
    ipc: str | None = recreate()
    isolation: str | None = recreate()
    labels: Labels | None = recreate()
    links: list[str] | None = recreate()
    logging: Logging | None = recreate()
    mac_address: str | None = recreate()
    masked_paths: list[str] | None = recreate()
    mem_limit: Memory | None = live()
    mem_reservation: Memory | None = live()
    mem_swappiness: Annotated[int, Field(ge=0, le=100)] | None = recreate()
    memswap_limit: Memory | None = live()
    network_disabled: bool | None = recreate()
    network_mode: str | None = recreate()
    networks: Annotated[dict[str, Network], BeforeValidator(_networks)] | None = recreate()
    oom_kill_disable: bool | None = recreate()
    oom_score_adj: Annotated[int, Field(ge=-1000, le=1000)] | None = recreate()
    pid: str | None = recreate()
    pids_limit: int | None = live()
    platform: str | None = recreate()
    ports: Texts | None = recreate()
    privileged: bool | None = recreate()
    publish_all_ports: bool | None = recreate()
    read_only: bool | None = recreate()
    readonly_paths: list[str] | None = recreate()
    restart: Annotated[str, Field(pattern=r"^(no|always|unless-stopped|on-failure(:[0-9]+)?)$")] | None = live(
        description="Restart policy of the engine. Leave it out: rorg restarts services, see spec.restart."
    )
    runtime: str | None = recreate()
    security_opt: list[str] | None = recreate()
    shm_size: Memory | None = recreate()
    stdin_open: bool | None = recreate()
    stop_grace_period: Duration | None = recreate()
    stop_signal: Signal | None = recreate()
    storage_opt: Pairs | None = recreate()
    sysctls: Pairs | None = recreate()
    tmpfs: Many | None = recreate()
    tty: bool | None = recreate()
    ulimits: Annotated[dict[str, Ulimit], BeforeValidator(_ulimits)] | None = recreate()
    user: Text | None = recreate()
    userns_mode: str | None = recreate()
    uts: str | None = recreate()
    volume_driver: str | None = recreate()
    volumes: list[Annotated[str | Mount, BeforeValidator(_volume)]] | None = recreate()
    volumes_from: list[str] | None = recreate()
    working_dir: str | None = recreate()


LIVE = frozenset(
    name
    for name, field in ContainerOptions.model_fields.items()
    if (field.json_schema_extra or {}).get("x-rorg-change") == "live"  # type: ignore[union-attr]
)
"""Options that the engine changes without a new container (docker update, docker rename)."""

ELSEWHERE = {
    "image": "spec.image",
    "command": "spec.command",
    "build": "a manifest of kind Image",
    "depends_on": "spec.needs",
    "deploy": "spec.resources, and cpus and mem_limit here",
    "profiles": "spec.profile",
    "scale": "one Service for each copy",
    "secrets": "volumes",
    "configs": "spec.mounts",
    "extends": "spec.profile",
    "auto_remove": "idle: {action: remove}; rorg removes containers itself",
    "links_external": "network_mode: host",
    "external_links": "network_mode: host",
    "pull_policy": "`rorg build`, which pulls what is missing",
    "credential_spec": "nothing: it is for Windows",
    "mounts": "spec.mounts, or volumes here",
    "nano_cpus": "cpus",
    "memory": "mem_limit",
}
"""Where users of Compose or of the engine's API will look for an option that is not in this section."""
