"""The options of a container, one line each: their names in Docker's API, in `docker run` and in Compose.

The engine's create body, the Compose reader, writer and importer, editors' dev containers and the comparison of
containers follow this table; their own files hold only what needs more than another name. The model of each option,
with its meaning and its checks, is in manifest/container.py. Tests check that both have the same options.
"""

from __future__ import annotations

from typing import NamedTuple


class Option(NamedTuple):
    """One option of a rendered container, under the name that Compose gives it."""

    api: str = ""
    """Its key in the body of POST /containers/create, if it has exactly one key."""
    flag: str = ""
    """The flag of `docker run` with the same value, or one flag per item. Empty if there is none."""
    compose: str = ""
    """The form of its value in a Compose file: a name of FORMS in compose/keys.py, `own` for a form of its own;
    empty if Compose does not have the option."""
    live: bool = False
    """The engine changes it without a new container (docker update, docker rename)."""
    empty: bool = True
    """An empty value (false, 0, no items) means the same as none."""


OPTIONS: dict[str, Option] = {
    "annotations": Option("HostConfig.Annotations", "annotation", "pairs"),
    "blkio_config": Option("", "", "own"),
    "cap_add": Option("HostConfig.CapAdd", "cap-add", "list"),
    "cap_drop": Option("HostConfig.CapDrop", "cap-drop", "list"),
    "cgroup": Option("HostConfig.CgroupnsMode", "cgroupns", "own", empty=False),
    "cgroup_parent": Option("HostConfig.CgroupParent", "cgroup-parent", "text"),
    "command": Option("Cmd", "", "words"),
    "container_name": Option("", "", "text", live=True, empty=False),
    "cpu_period": Option("HostConfig.CpuPeriod", "cpu-period", "int", live=True),
    "cpu_quota": Option("HostConfig.CpuQuota", "cpu-quota", "int", live=True),
    "cpu_rt_period": Option("HostConfig.CpuRealtimePeriod", "cpu-rt-period", "int", live=True),
    "cpu_rt_runtime": Option("HostConfig.CpuRealtimeRuntime", "cpu-rt-runtime", "int", live=True),
    "cpu_shares": Option("HostConfig.CpuShares", "cpu-shares", "int", live=True),
    "cpus": Option("HostConfig.NanoCpus", "cpus", "float", live=True),
    "cpuset": Option("HostConfig.CpusetCpus", "cpuset-cpus", "text", live=True),
    "cpuset_mems": Option("HostConfig.CpusetMems", "cpuset-mems", live=True),
    "device_cgroup_rules": Option("HostConfig.DeviceCgroupRules", "device-cgroup-rule", "list"),
    "devices": Option("HostConfig.Devices", "device", "own"),
    "dns": Option("HostConfig.Dns", "dns", "one or many"),
    "dns_opt": Option("HostConfig.DnsOptions", "dns-option", "list"),
    "dns_search": Option("HostConfig.DnsSearch", "dns-search", "one or many"),
    "domainname": Option("Domainname", "domainname", "text"),
    "entrypoint": Option("Entrypoint", "", "words", empty=False),
    "environment": Option("Env", "", "own", empty=False),
    "expose": Option("", "expose", "own"),
    "extra_hosts": Option("HostConfig.ExtraHosts", "add-host", "own"),
    "gpus": Option("HostConfig.DeviceRequests", "", "own"),
    "group_add": Option("HostConfig.GroupAdd", "group-add", "own"),
    "healthcheck": Option("Healthcheck", "", "own"),
    "hostname": Option("Hostname", "hostname", "text"),
    "image": Option("Image", "", "text", empty=False),
    "init": Option("HostConfig.Init", "init", "bool", empty=False),
    "ipc": Option("HostConfig.IpcMode", "ipc", "text"),
    "isolation": Option("HostConfig.Isolation", "isolation", "text"),
    "labels": Option("", "", "pairs"),
    "links": Option("HostConfig.Links", "link", "list"),
    "logging": Option("HostConfig.LogConfig", "", "own", empty=False),
    "mac_address": Option("MacAddress", "", "text"),
    "masked_paths": Option("HostConfig.MaskedPaths"),
    "mem_limit": Option("HostConfig.Memory", "memory", "size", live=True),
    "mem_reservation": Option("HostConfig.MemoryReservation", "memory-reservation", "size", live=True),
    "mem_swappiness": Option("HostConfig.MemorySwappiness", "memory-swappiness", "int", empty=False),
    "memswap_limit": Option("HostConfig.MemorySwap", "memory-swap", "size", live=True),
    "network_disabled": Option("NetworkDisabled"),
    "network_mode": Option("HostConfig.NetworkMode", "network", "text"),
    "networks": Option("", "", "own"),
    "oom_kill_disable": Option("HostConfig.OomKillDisable", "oom-kill-disable", "bool"),
    "oom_score_adj": Option("HostConfig.OomScoreAdj", "oom-score-adj", "int"),
    "pid": Option("HostConfig.PidMode", "pid", "text"),
    "pids_limit": Option("HostConfig.PidsLimit", "pids-limit", "int", live=True),
    "platform": Option("", "platform", "text"),
    "ports": Option("", "", "own"),
    "privileged": Option("HostConfig.Privileged", "privileged", "bool"),
    "publish_all_ports": Option("HostConfig.PublishAllPorts"),
    "read_only": Option("HostConfig.ReadonlyRootfs", "read-only", "bool"),
    "readonly_paths": Option("HostConfig.ReadonlyPaths"),
    "restart": Option("HostConfig.RestartPolicy", "", "text", live=True),
    "runtime": Option("HostConfig.Runtime", "runtime", "text"),
    "security_opt": Option("", "security-opt", "list"),
    "shm_size": Option("HostConfig.ShmSize", "shm-size", "size"),
    "stdin_open": Option("OpenStdin", "", "bool"),
    "stop_grace_period": Option("StopTimeout", "", "duration", empty=False),
    "stop_signal": Option("StopSignal", "stop-signal", "text"),
    "storage_opt": Option("HostConfig.StorageOpt", "storage-opt", "own"),
    "sysctls": Option("HostConfig.Sysctls", "sysctl", "pairs"),
    "tmpfs": Option("", "tmpfs", "one or many"),
    "tty": Option("Tty", "", "bool"),
    "ulimits": Option("HostConfig.Ulimits", "", "own"),
    "user": Option("User", "", "text"),
    "userns_mode": Option("HostConfig.UsernsMode", "userns", "text"),
    "uts": Option("HostConfig.UTSMode", "uts", "text"),
    "volume_driver": Option("HostConfig.VolumeDriver"),
    "volumes": Option("", "", "own"),
    "volumes_from": Option("HostConfig.VolumesFrom", "volumes-from", "list"),
    "working_dir": Option("WorkingDir", "", "text"),
}
LIVE = frozenset(name for name, option in OPTIONS.items() if option.live)
OF_COMPOSE = frozenset(name for name, option in OPTIONS.items() if option.compose)
