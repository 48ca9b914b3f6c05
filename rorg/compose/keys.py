"""Every key of a Compose file and its form. The source is the Compose Specification, with keys that came after Compose
2.26 (gpus, label_file, provider, models, post_start, pre_stop, use_api_socket, pull_refresh_after)."""

from __future__ import annotations

from posixpath import normpath
from typing import Any

from rorg.compose import shorts
from rorg.compose.form import ANY, Context
from rorg.compose.forms import Changed, Contexts, Either, ListOf, MapOf, Pairs, Section, Words, is_remote
from rorg.compose.nodes import Node
from rorg.compose.scalars import BOOL, DURATION, FLOAT, INT, LOOSE, NUMBER_OR_TEXT, SIZE, TEXT, PathOf, Scalar, one_of

TEXTS = ListOf(TEXT)
UNIQUE = ListOf(TEXT, key=lambda text: text)
ONE_OR_MANY = ListOf(TEXT, single=True, key=lambda text: text)
OPTIONS = MapOf(NUMBER_OR_TEXT)


def _source(node: Node, name: str, context: Context) -> Node:
    """Of a mount: the source of a bind is a path of this machine."""
    entries = dict(node.value)
    source, kind = entries.get("source"), entries.get("type")
    if kind and kind.value == "bind":
        if source is None:
            context.error(node, f"{name} is a bind without a source", "source: PATH")
        elif not (source.value.startswith("/") and ":" not in source.value):
            entries["source"] = source.but(context.path(source.value))
    target = entries.get("target")
    if target is None:
        context.error(node, f"{name} has no target", "target: PATH in the container")
    else:
        entries["target"] = target.but(normpath(target.value))
    return node.but(entries)


def _health(node: Node, name: str, context: Context) -> Node:
    test = node.mapping.get("test")
    if test and (not test.items or test.items[0].value not in ("NONE", "CMD", "CMD-SHELL")):
        context.error(
            test, f"{name}.test begins with none of NONE, CMD and CMD-SHELL", '["CMD", "curl", "..."], or text'
        )
    return node


ULIMITS = MapOf(Either(Section({"soft": INT, "hard": INT}, required=("soft", "hard")), INT))
HOSTS = Changed(shorts.hosts, TEXTS)
COUNT = Scalar("a number, or all", (int, str), shorts.count)
_DEVICE = {
    "capabilities": TEXTS,
    "count": COUNT,
    "device_ids": TEXTS,
    "driver": TEXT,
    "options": Pairs(),
}
HOOK = Section(
    {"command": Words(), "user": TEXT, "privileged": BOOL, "working_dir": TEXT, "environment": Pairs(bare=True)}
)


def _of_secret(plain: Any) -> object:
    return (plain.get("target") or plain.get("source")) if isinstance(plain, dict) else plain


SECRETS = ListOf(
    Section(
        {"source": TEXT, "target": TEXT, "uid": TEXT, "gid": TEXT, "mode": INT},
        short=shorts.named("source"),
        required=("source",),
    ),
    key=_of_secret,
)
BUILD = Section(
    {
        "context": PathOf(kept=is_remote),
        "dockerfile": TEXT,
        "dockerfile_inline": TEXT,
        "entitlements": TEXTS,
        "args": Pairs(bare=True),
        "ssh": Changed(lambda n, _, __: shorts.listed_pairs(n), TEXTS, dict),
        "labels": Pairs(),
        "cache_from": TEXTS,
        "cache_to": TEXTS,
        "no_cache": BOOL,
        "additional_contexts": Contexts(),
        "network": TEXT,
        "provenance": LOOSE,
        "sbom": LOOSE,
        "pull": BOOL,
        "target": TEXT,
        "shm_size": SIZE,
        "extra_hosts": HOSTS,
        "isolation": TEXT,
        "privileged": BOOL,
        "secrets": SECRETS,
        "tags": UNIQUE,
        "ulimits": ULIMITS,
        "platforms": TEXTS,
    },
    short=shorts.named("context"),
)
MOUNT = Section(
    {
        "type": one_of("bind", "volume", "tmpfs", "cluster", "npipe", "image"),
        "source": TEXT,
        "target": TEXT,
        "read_only": BOOL,
        "consistency": TEXT,
        "bind": Section(
            {
                "propagation": TEXT,
                "create_host_path": BOOL,
                "recursive": one_of("enabled", "disabled", "writable", "readonly"),
                "selinux": one_of("z", "Z"),
            }
        ),
        "volume": Section({"labels": Pairs(), "nocopy": BOOL, "subpath": TEXT}),
        "tmpfs": Section({"size": SIZE, "mode": INT}),
        "image": Section({"subpath": TEXT}),
    },
    short=shorts.volume,
    required=("type",),
    finish=_source,
)
PORT = Section(
    {
        "name": TEXT,
        "mode": TEXT,
        "host_ip": TEXT,
        "target": INT,
        "published": NUMBER_OR_TEXT,
        "protocol": TEXT,
        "app_protocol": TEXT,
    },
    required=("target",),
    defaults={"mode": "ingress", "protocol": "tcp"},
)
DEVICE = Section(
    {"source": TEXT, "target": TEXT, "permissions": TEXT},
    short=shorts.device,
    required=("source",),
    defaults={"permissions": "rwm"},
    finish=shorts.whole_device,
)
ENV_FILE = Section(
    {"path": PathOf(), "required": BOOL, "format": one_of("raw")},
    short=shorts.named("path"),
    required=("path",),
    defaults={"required": True},
)
DEPENDS_ON = Changed(
    shorts.depends_on,
    MapOf(
        Section(
            {
                "condition": one_of("service_started", "service_healthy", "service_completed_successfully"),
                "restart": BOOL,
                "required": BOOL,
            },
            required=("condition",),
            defaults={"required": True},
        )
    ),
    only=(list, str, int, float, bool),
)
HEALTHCHECK = Section(
    {
        "disable": BOOL,
        "interval": DURATION,
        "retries": INT,
        "test": Changed(shorts.health_test, ListOf(TEXT, replaced=True), str),
        "timeout": DURATION,
        "start_period": DURATION,
        "start_interval": DURATION,
    },
    finish=_health,
)
_UPDATE = Section(
    {
        "parallelism": INT,
        "delay": DURATION,
        "failure_action": TEXT,
        "monitor": DURATION,
        "max_failure_ratio": FLOAT,
        "order": one_of("start-first", "stop-first"),
    }
)
_GENERIC = Section({"discrete_resource_spec": Section({"kind": TEXT, "value": INT})})
DEPLOY = Section(
    {
        "mode": TEXT,
        "endpoint_mode": TEXT,
        "replicas": INT,
        "labels": Pairs(),
        "rollback_config": _UPDATE,
        "update_config": _UPDATE,
        "resources": Section(
            {
                "limits": Section({"cpus": FLOAT, "memory": SIZE, "pids": INT}),
                "reservations": Section(
                    {
                        "cpus": FLOAT,
                        "memory": SIZE,
                        "generic_resources": ListOf(_GENERIC),
                        "devices": ListOf(Section(_DEVICE)),
                    }
                ),
            }
        ),
        "restart_policy": Section({"condition": TEXT, "delay": DURATION, "max_attempts": INT, "window": DURATION}),
        "placement": Section(
            {
                "constraints": TEXTS,
                "preferences": ListOf(Section({"spread": TEXT})),
                "max_replicas_per_node": INT,
            }
        ),
    }
)
GPUS = ListOf(Section(_DEVICE))
DEVELOP = Section(
    {
        "watch": ListOf(
            Section(
                {
                    "ignore": ONE_OR_MANY,
                    "include": ONE_OR_MANY,
                    "path": PathOf(),
                    "action": one_of("rebuild", "sync", "restart", "sync+restart", "sync+exec"),
                    "target": TEXT,
                    "exec": HOOK,
                },
                required=("path", "action"),
            )
        )
    }
)
NETWORKS = MapOf(
    Section(
        {
            "aliases": TEXTS,
            "interface_name": TEXT,
            "ipv4_address": TEXT,
            "ipv6_address": TEXT,
            "link_local_ips": TEXTS,
            "mac_address": TEXT,
            "driver_opts": OPTIONS,
            "priority": INT,
            "gw_priority": INT,
        }
    ),
    names=True,
    null=True,
)
LOGGING = Section({"driver": TEXT, "options": Pairs()}, same="driver")
_RATE = ListOf(Section({"path": TEXT, "rate": SIZE}))
BLKIO = Section(
    {
        **{f"device_{how}_{unit}": _RATE for how in ("read", "write") for unit in ("bps", "iops")},
        "weight": INT,
        "weight_device": ListOf(Section({"path": TEXT, "weight": INT})),
    },
    extensible=False,
)
EXTENDS = Section(
    {"service": TEXT, "file": TEXT}, short=shorts.named("service"), required=("service",), extensible=False
)
PROVIDER = Section({"type": TEXT, "options": ANY}, required=("type",))
