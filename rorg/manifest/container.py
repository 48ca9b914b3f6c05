"""The `container:` section: every option of the engine's create call, under Compose's names.

Each field is marked in `x-rorg-change` with the cost of a change for a running container: `live` (the engine updates it
in place) or `recreate` (stop, remove, create, start).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from rorg.manifest import option_checks as check
from rorg.manifest.fields import Written, live, recreate
from rorg.manifest.long_forms import Device, EnvFiles, PortForm
from rorg.manifest.option_forms import (
    Bytes,
    Cores,
    Duration,
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

CONTAINER_NAME = r"^(\$\{service\}|[a-zA-Z0-9]([a-zA-Z0-9_.-]|\$\{service\}))([a-zA-Z0-9_.-]|\$\{service\})*$"
PERIOD = "write 1000 to 1000000, in microseconds"


class ContainerOptions(Strict):
    """Options of the container, named as in Compose. rorg decides some things itself (image, command, restart of
    services); their fields are outside this section."""

    annotations: Pairs | None = recreate("Annotations for the container runtime.", {"org.example.team": "arms"})
    blkio_config: BlkioConfig | None = recreate("Limits and shares of block devices.", {"weight": 300})
    cap_add: list[Annotated[str, check.CAPABILITY]] | None = recreate("Linux capabilities to add.", ["NET_ADMIN"])
    cap_drop: list[Annotated[str, check.CAPABILITY]] | None = recreate("Linux capabilities to remove.", ["ALL"])
    cgroup: Literal["host", "private"] | None = recreate(
        "The cgroup namespace: the host's, or a private one.", "private", unset="what the engine is set to"
    )
    cgroup_parent: Annotated[str, check.PARENT] | None = recreate(
        "The parent control group of the container.", "robot.slice"
    )
    container_name: Annotated[str, Field(pattern=CONTAINER_NAME), check.CONTAINER] | None = live(
        "Name of the container.", "fetch-navigation", unset="the service's name"
    )
    cpu_period: Annotated[int, check.between((0, 0), (1000, 1_000_000), what=PERIOD)] | None = live(
        "Period of the CPU limit in microseconds, for cpu_quota. `cpus` is simpler.", 100000
    )
    cpu_quota: Annotated[int, check.between((-1, 0), (1000, 1 << 40), what="write 1000 or more")] | None = live(
        "CPU time in microseconds that the container may use in each cpu_period; -1 is no limit.", 50000
    )
    cpu_rt_period: Annotated[int, Field(ge=0, le=1 << 40)] | None = live(
        "Period of the CPU limit for real-time tasks, in microseconds.", 1000000
    )
    cpu_rt_runtime: Annotated[int, Field(ge=0, le=1 << 40)] | None = live(
        "CPU time of real-time tasks in each cpu_rt_period, in microseconds.", 950000
    )
    cpu_shares: Annotated[int, check.between((0, 0), (2, 262144), what="write 2 to 262144")] | None = live(
        "Weight of the container when the CPU is contended; 1024 is usual.", 512
    )
    cpus: Cores | None = live("Most CPU that the container may use, in cores.", 0.5, unset="no limit")
    cpuset: Annotated[Text, check.CPUS] | None = live("CPUs that the container may run on.", "0-2,4", unset="all")
    cpuset_mems: Annotated[Text, check.CPUS] | None = live(
        "NUMA nodes whose memory the container may use.", "0", unset="all"
    )
    device_cgroup_rules: list[Annotated[str, check.DEVICE_RULE]] | None = recreate(
        "Classes of devices that the container may use, in addition to `devices`.", ["c 188:* rw"]
    )
    devices: list[Device] | None = recreate(
        "Devices of the host: PATH, PATH:PATH_INSIDE, PATH:PATH_INSIDE:rwm, or a mapping. For hardware, "
        "write `driver`.",
        ["/dev/video0:/dev/camera"],
    )
    dns: Many[Annotated[str, check.IP]] | None = recreate("Name servers.", ["192.168.1.1"], unset="the host's")
    dns_opt: Many[Annotated[str, check.WORD]] | None = recreate("Options of the resolver.", ["timeout:1"])
    dns_search: Many[Annotated[str, check.DOMAIN]] | None = recreate(
        "Domains in which short names are looked up.", ["robot.local"], unset="the host's"
    )
    domainname: Annotated[str, check.DOMAIN] | None = recreate("Domain of the container's host name.", "robot.local")
    entrypoint: Words | None = recreate(
        "Replaces the entry point of the image; the command follows it.", "/ros_entrypoint.sh", unset="the image's"
    )
    env_file: EnvFiles | None = recreate(
        "Files of variables, relative to the manifest, in Compose's format; `environment` overrides them.",
        ["./arm.env"],
    )
    environment: Annotated[Pairs, check.VARIABLES] | None = recreate(
        "Environment variables.", {"ROS_MASTER_URI": "http://localhost:11311"}
    )
    expose: list[Annotated[Text, check.EXPOSE]] | None = recreate(
        "Ports that other containers on the same network may reach.", ["9090"]
    )
    extra_hosts: Hosts | None = recreate("Lines of /etc/hosts in the container.", ["base:192.168.1.10"])
    gpus: Gpus | None = recreate("GPUs of the host: all, or a list of requests.", "all")
    group_add: list[Annotated[Text, check.GROUP]] | None = recreate(
        "Groups of the container's user, by name or number.", ["dialout", "video"]
    )
    healthcheck: Healthcheck | None = recreate(
        "The engine's own check of the container. `ready` and `live` of the service do not need it.",
        {"test": "curl -f http://localhost:8080/health", "interval": "10s"},
        unset="the image's",
    )
    hostname: Annotated[str, check.HOST_NAME] | None = recreate("Host name inside the container.", "robot")
    init: bool | None = recreate("Runs a small init that forwards signals and reaps zombies.", True)
    ipc: Annotated[str, check.IPC] | None = recreate(
        "Shared memory: none, private, shareable, host, service:NAME or container:NAME. A service whose memory others "
        "use must be `shareable`. ROS 2 shares memory through `host`.",
        "host",
    )
    isolation: Literal["default"] | None = recreate("Isolation technology; Linux has one.", "default")
    labels: Labels | None = recreate("Labels of the container, for other tools.", {"team": "arms"})
    links: list[Annotated[str, check.LINK]] | None = recreate(
        "Other containers to reach by name: NAME or NAME:ALIAS. A network of your own does more.", ["db:database"]
    )
    logging: Logging | None = recreate(
        "The destination of the output, and how much of it to keep.",
        {"driver": "json-file", "options": {"max-size": "10m", "max-file": "3"}},
    )
    mac_address: Annotated[str, check.MAC] | None = recreate("MAC address in the network.", "02:42:ac:11:00:02")
    masked_paths: list[Annotated[str, check.PATH]] | None = recreate(
        "Paths that are hidden inside the container.", ["/proc/kcore"], unset="the engine's list"
    )
    mem_limit: Limit | None = live(
        "Most memory that the container may use; the kernel kills a process that needs more.", "512Mi", unset="no limit"
    )
    mem_reservation: Limitless | None = live(
        "Memory that the container is reduced to when the machine runs short.", "256Mi", unset="none"
    )
    mem_swappiness: Annotated[int, Field(ge=0, le=100)] | None = recreate(
        "How readily its memory is swapped out, 0 to 100 (cgroup v1).", 10
    )
    memswap_limit: Limitless | None = live(
        "Most memory and swap together; -1 is any amount of swap. Needs mem_limit.", "1Gi", unset="twice mem_limit"
    )
    network_disabled: bool | None = recreate("The container has no network at all.", True, unset="false")
    network_mode: Annotated[str, check.NETWORK_MODE] | None = recreate(
        "The network: host, bridge, none, the name of a network, service:NAME for that of another service's container, "
        "or container:NAME. A service here counts as needed, and its restart restarts this one.",
        "bridge",
    )
    networks: Networks | None = recreate("Networks to join, instead of network_mode.", ["robot"])
    oom_kill_disable: bool | None = recreate(
        "The kernel does not kill its processes when memory is short (cgroup v1).", True, unset="false"
    )
    oom_score_adj: Annotated[int, Field(ge=-1000, le=1000)] | None = recreate(
        "How soon the kernel kills it when memory is short: -1000 never, 1000 first.", -500, unset="0"
    )
    pid: Annotated[str, check.PID] | None = recreate(
        "Processes that it sees: host, service:NAME or container:NAME. A service here counts as needed.", "host"
    )
    pids_limit: Annotated[int, Field(ge=-1, le=1 << 40)] | None = live(
        "Most processes and threads; -1 is no limit.", 8192
    )
    platform: Annotated[str, check.PLATFORM] | None = recreate(
        "Platform of the image, if it has several.", "linux/arm64", unset="the machine's"
    )
    ports: list[PortForm] | None = recreate(
        "Ports to publish on the host: HOST:CONTAINER, IP:HOST:CONTAINER, with /udp for UDP, or a mapping. Not under "
        "network_mode: host.",
        ["8080:80"],
    )
    privileged: bool | None = recreate(
        "All devices and all capabilities, equal to root on the host. `driver` gives only what is needed.",
        True,
        unset="false",
    )
    publish_all_ports: bool | None = recreate("Publishes all ports that the image exposes.", True, unset="false")
    read_only: bool | None = recreate("The container's file system is read only.", True, unset="false")
    readonly_paths: list[Annotated[str, check.PATH]] | None = recreate(
        "Paths that are read only inside the container.", ["/proc/sys"], unset="the engine's list"
    )
    restart: (
        Annotated[
            str,
            Field(pattern=r"^(no|always|unless-stopped|on-failure(:[0-9]+)?)$"),
            Written("no | always | unless-stopped | on-failure[:TIMES]"),
        ]
        | None
    ) = live("Restart policy of the engine. Leave it out: rorg restarts services, see spec.restart.", "no", unset="no")
    runtime: Annotated[str, check.RUNTIME] | None = recreate(
        "The container runtime, by its name.", "nvidia", unset="the engine's"
    )
    security_opt: list[Annotated[str, check.SECURITY]] | None = recreate(
        "Security options: no-new-privileges, seccomp=FILE, apparmor=PROFILE, label=...", ["apparmor=unconfined"]
    )
    shm_size: Bytes | None = recreate("Size of /dev/shm.", "256Mi", unset="64Mi")
    stdin_open: bool | None = recreate("Keeps standard input open.", True, unset="false")
    stop_grace_period: Duration | None = recreate("Time between the stop signal and the kill.", "10s", unset="10s")
    stop_signal: Signal | None = recreate("The signal that stops it.", "SIGINT", unset="the image's, else SIGTERM")
    storage_opt: Pairs | None = recreate("Options of the engine's storage driver.", {"size": "20G"})
    sysctls: Annotated[Pairs, check.SYSCTLS] | None = recreate(
        "Kernel parameters of the container's own namespaces.", {"net.ipv4.ip_local_port_range": "40000 50000"}
    )
    tmpfs: Many[Annotated[str, check.TMPFS]] | None = recreate(
        "Directories in memory: PATH, or PATH:OPTIONS.", ["/tmp:size=64m"]
    )
    tty: bool | None = recreate("Gives it a terminal.", True, unset="false")
    ulimits: Ulimits | None = recreate(
        "Limits of the kernel, each as one number or as {soft, hard}.",
        {"nofile": 65536, "core": {"soft": 0, "hard": 0}},
    )
    user: Annotated[Text, check.USER] | None = recreate(
        "The user inside the container: NAME, UID or UID:GID.", "1000:1000", unset="the image's"
    )
    userns_mode: Annotated[str, check.HOST_ONLY] | None = recreate("The user namespace: host.", "host")
    uts: Annotated[str, check.HOST_ONLY] | None = recreate("The host name's namespace: host.", "host")
    volume_driver: Annotated[str, check.VOLUME_DRIVER] | None = recreate(
        "Driver of volumes that are created for it.", "local", unset="local"
    )
    volumes: list[Volume] | None = recreate(
        "Files, directories and volumes inside the container: SOURCE:TARGET, SOURCE:TARGET:ro, or a mapping. Sources "
        "that begin with ./ are relative to the manifest.",
        ["./navigation:/root/navigation:ro", "maps:/root/maps"],
    )
    volumes_from: list[Annotated[str, check.VOLUMES_FROM]] | None = recreate(
        "Containers whose volumes it also has: NAME or NAME:ro of a service, which it then needs, or container:NAME.",
        ["recorder:ro"],
    )
    working_dir: Annotated[str, check.WORKING_DIR] | None = recreate(
        "Directory that the command runs in. On the process engine, ./dir and ../dir are relative to the manifest.",
        "/root/navigation",
        unset="the image's; on the process engine, the manifest's directory",
    )
