"""The `container:` section: every option of the engine's create call, under Compose's names.

Each field says what a change of it costs a running container, in `x-rorg-change`:
`live` (the engine updates it in place), or `recreate` (stop, remove, create, start).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from rorg.manifest import option_checks as check
from rorg.manifest.option_forms import (
    Bytes,
    Cores,
    Device,
    Labels,
    Limit,
    Limitless,
    Many,
    Pairs,
    Signal,
    Strict,
    Text,
    Words,
)
from rorg.manifest.option_parts import BlkioConfig, Gpus, Healthcheck, Hosts, Logging, Networks, Ulimits, Volume
from rorg.manifest.scalars import Duration


def recreate(**extra: Any) -> Any:
    """A field whose change costs a new container."""
    return Field(default=None, json_schema_extra={"x-rorg-change": "recreate"}, **extra)


def live(**extra: Any) -> Any:
    """A field that the engine changes in place."""
    return Field(default=None, json_schema_extra={"x-rorg-change": "live"}, **extra)


def unchanging(default: Any = None, **extra: Any) -> Any:
    """A field whose change costs a running container nothing."""
    return Field(default=default, json_schema_extra={"x-rorg-change": "none"}, **extra)


CONTAINER_NAME = r"^(\$\{service\}|[a-zA-Z0-9]([a-zA-Z0-9_.-]|\$\{service\}))([a-zA-Z0-9_.-]|\$\{service\})*$"
PERIOD = "write 1000 to 1000000, in microseconds"


class ContainerOptions(Strict):
    """Options of the container, named as in Compose. What rorg itself decides (image, command, restart of
    services) stands outside of this section."""

    annotations: Pairs | None = recreate()
    blkio_config: BlkioConfig | None = recreate()
    cap_add: list[Annotated[str, check.CAPABILITY]] | None = recreate()
    cap_drop: list[Annotated[str, check.CAPABILITY]] | None = recreate()
    cgroup: Literal["host", "private"] | None = recreate()
    cgroup_parent: Annotated[str, check.PARENT] | None = recreate()
    container_name: Annotated[str, Field(pattern=CONTAINER_NAME), check.CONTAINER] | None = live(
        description="Name of the container; the service's name by default."
    )
    cpu_period: Annotated[int, check.between((0, 0), (1000, 1_000_000), what=PERIOD)] | None = live()
    cpu_quota: Annotated[int, check.between((-1, 0), (1000, 1 << 40), what="write 1000 or more")] | None = live()
    cpu_rt_period: Annotated[int, Field(ge=0, le=1 << 40)] | None = live()
    cpu_rt_runtime: Annotated[int, Field(ge=0, le=1 << 40)] | None = live()
    cpu_shares: Annotated[int, check.between((0, 0), (2, 262144), what="write 2 to 262144")] | None = live()
    cpus: Cores | None = live(description="Limit of CPU, in cores.")
    cpuset: Annotated[Text, check.CPUS] | None = live()
    cpuset_mems: Annotated[Text, check.CPUS] | None = live()
    device_cgroup_rules: list[Annotated[str, check.DEVICE_RULE]] | None = recreate()
    devices: list[Device] | None = recreate()
    dns: Many[Annotated[str, check.IP]] | None = recreate()
    dns_opt: Many[Annotated[str, check.WORD]] | None = recreate()
    dns_search: Many[Annotated[str, check.DOMAIN]] | None = recreate()
    domainname: Annotated[str, check.DOMAIN] | None = recreate()
    entrypoint: Words | None = recreate()
    env_file: Many[Annotated[str, check.WORD]] | None = recreate(
        description="Files of KEY=VALUE lines; `environment` wins over them."
    )
    environment: Annotated[Pairs, check.VARIABLES] | None = recreate()
    expose: list[Annotated[Text, check.EXPOSE]] | None = recreate()
    extra_hosts: Hosts | None = recreate()
    gpus: Gpus | None = recreate()
    group_add: list[Annotated[Text, check.GROUP]] | None = recreate()
    healthcheck: Healthcheck | None = recreate()
    hostname: Annotated[str, check.HOST_NAME] | None = recreate()
    init: bool | None = recreate()
    ipc: Annotated[str, check.IPC] | None = recreate()
    isolation: Literal["default"] | None = recreate()
    labels: Labels | None = recreate()
    links: list[Annotated[str, check.LINK]] | None = recreate()
    logging: Logging | None = recreate()
    mac_address: Annotated[str, check.MAC] | None = recreate()
    masked_paths: list[Annotated[str, check.PATH]] | None = recreate()
    mem_limit: Limit | None = live()
    mem_reservation: Limitless | None = live()
    mem_swappiness: Annotated[int, Field(ge=0, le=100)] | None = recreate()
    memswap_limit: Limitless | None = live()
    network_disabled: bool | None = recreate()
    network_mode: Annotated[str, check.NETWORK_MODE] | None = recreate()
    networks: Networks | None = recreate()
    oom_kill_disable: bool | None = recreate()
    oom_score_adj: Annotated[int, Field(ge=-1000, le=1000)] | None = recreate()
    pid: Annotated[str, check.PID] | None = recreate()
    pids_limit: Annotated[int, Field(ge=-1, le=1 << 40)] | None = live()
    platform: Annotated[str, check.PLATFORM] | None = recreate()
    ports: list[Annotated[Text, check.PORTS]] | None = recreate()
    privileged: bool | None = recreate()
    publish_all_ports: bool | None = recreate()
    read_only: bool | None = recreate()
    readonly_paths: list[Annotated[str, check.PATH]] | None = recreate()
    restart: Annotated[str, Field(pattern=r"^(no|always|unless-stopped|on-failure(:[0-9]+)?)$")] | None = live(
        description="Restart policy of the engine. Leave it out: rorg restarts services, see spec.restart."
    )
    runtime: Annotated[str, check.RUNTIME] | None = recreate()
    security_opt: list[Annotated[str, check.SECURITY]] | None = recreate()
    shm_size: Bytes | None = recreate()
    stdin_open: bool | None = recreate()
    stop_grace_period: Duration | None = recreate()
    stop_signal: Signal | None = recreate()
    storage_opt: Pairs | None = recreate()
    sysctls: Annotated[Pairs, check.SYSCTLS] | None = recreate()
    tmpfs: Many[Annotated[str, check.TMPFS]] | None = recreate()
    tty: bool | None = recreate()
    ulimits: Ulimits | None = recreate()
    user: Annotated[Text, check.USER] | None = recreate()
    userns_mode: Annotated[str, check.HOST_ONLY] | None = recreate()
    uts: Annotated[str, check.HOST_ONLY] | None = recreate()
    volume_driver: Annotated[str, check.VOLUME_DRIVER] | None = recreate()
    volumes: list[Volume] | None = recreate()
    volumes_from: list[Annotated[str, check.VOLUMES_FROM]] | None = recreate()
    working_dir: Annotated[str, check.WORKING_DIR] | None = recreate(
        description="Where its program begins. On the process engine ./dir and ../dir are beside the manifest, "
        "which is the default."
    )


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
