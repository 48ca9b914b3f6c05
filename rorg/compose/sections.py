"""The sections of a Compose file: what a service, a network, a volume, a config, a secret may say."""

from __future__ import annotations

from rorg.compose import keys, shorts
from rorg.compose.form import ANY
from rorg.compose.forms import Changed, Either, ListOf, MapOf, Pairs, Section, Words
from rorg.compose.keys import ONE_OR_MANY, OPTIONS, UNIQUE
from rorg.compose.scalars import BOOL, DURATION, FLOAT, INT, NUMBER_OR_TEXT, SIZE, TEXT, PathOf, Scalar, one_of

SERVICE = Section(
    {
        "annotations": Pairs(),
        "attach": BOOL,
        "blkio_config": keys.BLKIO,
        "build": keys.BUILD,
        "cap_add": UNIQUE,
        "cap_drop": UNIQUE,
        "cgroup": one_of("host", "private"),
        "cgroup_parent": TEXT,
        "command": Words(),
        "configs": keys.SECRETS,
        "container_name": TEXT,
        "cpu_count": INT,
        "cpu_percent": FLOAT,
        "cpu_period": INT,
        "cpu_quota": INT,
        "cpu_rt_period": INT,
        "cpu_rt_runtime": INT,
        "cpu_shares": INT,
        "cpus": FLOAT,
        "cpuset": TEXT,
        "credential_spec": Section({"config": TEXT, "file": TEXT, "registry": TEXT}),
        "depends_on": keys.DEPENDS_ON,
        "deploy": keys.DEPLOY,
        "develop": keys.DEVELOP,
        "device_cgroup_rules": UNIQUE,
        "devices": ListOf(keys.DEVICE, key=lambda device: device.get("target")),
        "dns": ONE_OR_MANY,
        "dns_opt": UNIQUE,
        "dns_search": ONE_OR_MANY,
        "domainname": TEXT,
        "entrypoint": Words(),
        "env_file": ListOf(keys.ENV_FILE, single=True),
        "environment": Pairs(bare=True),
        "expose": ListOf(NUMBER_OR_TEXT, key=str),
        "extends": keys.EXTENDS,
        "external_links": UNIQUE,
        "extra_hosts": keys.HOSTS,
        "gpus": Changed(shorts.all_gpus, keys.GPUS, str),
        "group_add": ListOf(NUMBER_OR_TEXT, key=str),
        "healthcheck": keys.HEALTHCHECK,
        "hostname": TEXT,
        "image": TEXT,
        "init": BOOL,
        "ipc": TEXT,
        "isolation": TEXT,
        "label_file": ListOf(PathOf(), single=True),
        "labels": Pairs(),
        "links": UNIQUE,
        "logging": keys.LOGGING,
        "mac_address": TEXT,
        "mem_limit": SIZE,
        "mem_reservation": SIZE,
        "mem_swappiness": INT,
        "memswap_limit": SIZE,
        "models": ANY,
        "network_mode": TEXT,
        "networks": keys.NETWORKS,
        "oom_kill_disable": BOOL,
        "oom_score_adj": INT,
        "pid": TEXT,
        "pids_limit": INT,
        "platform": TEXT,
        "ports": ListOf(
            keys.PORT,
            spread=shorts.ports,
            key=lambda p: (p.get("host_ip"), p.get("published"), p.get("target"), p.get("protocol")),
        ),
        "post_start": ListOf(keys.HOOK),
        "pre_stop": ListOf(keys.HOOK),
        "privileged": BOOL,
        "profiles": UNIQUE,
        "provider": keys.PROVIDER,
        "pull_policy": Scalar("text", (str,), lambda text: "missing" if text == "if_not_present" else text),
        "pull_refresh_after": TEXT,
        "read_only": BOOL,
        "restart": TEXT,
        "runtime": TEXT,
        "scale": INT,
        "secrets": keys.SECRETS,
        "security_opt": UNIQUE,
        "shm_size": SIZE,
        "stdin_open": BOOL,
        "stop_grace_period": DURATION,
        "stop_signal": TEXT,
        "storage_opt": OPTIONS,
        "sysctls": Pairs(),
        "tmpfs": ONE_OR_MANY,
        "tty": BOOL,
        "ulimits": keys.ULIMITS,
        "use_api_socket": BOOL,
        "user": TEXT,
        "userns_mode": TEXT,
        "uts": TEXT,
        "volumes": ListOf(keys.MOUNT, key=lambda volume: volume.get("target")),
        "volumes_from": UNIQUE,
        "working_dir": TEXT,
    }
)
_EXTERNAL = Either(Section({"name": TEXT}), BOOL)
_IPAM = Section(
    {
        "driver": TEXT,
        "config": ListOf(Section({"subnet": TEXT, "ip_range": TEXT, "gateway": TEXT, "aux_addresses": MapOf(TEXT)})),
        "options": MapOf(TEXT),
    }
)
_NAMED = {"name": TEXT, "external": _EXTERNAL, "labels": Pairs()}
_DRIVEN = {**_NAMED, "driver": TEXT, "driver_opts": OPTIONS}
NETWORK = Section(
    {
        **_DRIVEN,
        "ipam": _IPAM,
        "internal": BOOL,
        "enable_ipv4": BOOL,
        "enable_ipv6": BOOL,
        "attachable": BOOL,
    },
    finish=shorts.external,
)
VOLUME = Section(_DRIVEN, finish=shorts.external)
_GIVEN = {**_NAMED, "file": PathOf(), "environment": TEXT, "template_driver": TEXT}
CONFIG = Section({**_GIVEN, "content": TEXT}, finish=shorts.external)
SECRET = Section({**_GIVEN, "driver": TEXT, "driver_opts": OPTIONS}, finish=shorts.external)
INCLUDE = Section(
    {"path": ONE_OR_MANY, "env_file": ONE_OR_MANY, "project_directory": TEXT},
    short=shorts.named("path"),
    required=("path",),
    extensible=False,
)
FILE = Section(
    {
        "version": NUMBER_OR_TEXT,
        "name": TEXT,
        "include": ListOf(INCLUDE),
        "services": MapOf(SERVICE, null=True, extensible=False),
        "networks": MapOf(NETWORK, null=True),
        "volumes": MapOf(VOLUME, null=True),
        "configs": MapOf(CONFIG),
        "secrets": MapOf(SECRET),
        "models": ANY,
    }
)
