"""Every key of a Compose file and its form: what a service, network, volume, config or secret may say.

The source is the Compose Specification, with keys that came after Compose 2.26 (gpus, label_file, provider, models,
post_start, pre_stop, use_api_socket, pull_refresh_after).
"""

from __future__ import annotations

from collections.abc import Mapping
from posixpath import normpath
from typing import Any

from rorg.model.options import OPTIONS as CONTAINER_OPTIONS
from rorg.tools.compose import shorts
from rorg.tools.compose.form import ANY, Context, Form
from rorg.tools.compose.forms import Contexts, Either, ListOf, MapOf, Pairs, Section, Words, is_remote, one_or_many
from rorg.tools.compose.nodes import Node
from rorg.tools.compose.scalars import (
    BOOL,
    DURATION,
    FLOAT,
    INT,
    LOOSE,
    NUMBER_OR_TEXT,
    SIZE,
    TEXT,
    PathOf,
    Scalar,
    one_of,
)

TEXTS = ListOf(TEXT)
UNIQUE = ListOf(TEXT, key=lambda text: text)
ONE_OR_MANY = one_or_many(TEXT, key=lambda text: text)
OPTIONS = MapOf(NUMBER_OR_TEXT)


def _keys(form: Form, names: str) -> dict[str, Form]:
    """Several keys of the same form."""
    return dict.fromkeys(names.split(), form)


def _source(node: Node, name: str, context: Context) -> Node:
    """A mount, with the source of a bind as an absolute path of this machine."""
    source, target = node.get("source"), node.get("target")
    if node.get("type").value == "bind":
        if source.value is None:
            context.error(node, f"{name} is a bind without a source", "source: PATH")
        elif not (source.value.startswith("/") and ":" not in source.value):
            node = node.having(source=source.but(context.path(source.value)))
    if target.value is None:
        context.error(node, f"{name} has no target", "target: PATH in the container")
        return node
    return node.having(target=target.but(normpath(target.value)))


def _health(node: Node, name: str, context: Context) -> Node:
    test = node.get("test")
    if test.value is not None and (not test.items or test.items[0].value not in ("NONE", "CMD", "CMD-SHELL")):
        message = f"{name}.test does not begin with NONE, CMD or CMD-SHELL"
        context.error(test, message, '["CMD", "curl", "..."], or text')
    return node


def _of_secret(plain: Any) -> object:
    return (plain.get("target") or plain.get("source")) if isinstance(plain, dict) else plain


ULIMITS = MapOf(Either(Section({"soft": INT, "hard": INT}, required=("soft", "hard")), INT))
HOSTS = ListOf(TEXT, short=shorts.hosts, of=(dict, list), wanted="a mapping, or a list of HOST=ADDRESS")
COUNT = Scalar("a number, or all", (int, str), shorts.count)
_DEVICE = {**_keys(TEXTS, "capabilities device_ids"), "count": COUNT, "driver": TEXT, "options": Pairs()}
HOOK = Section(
    {"command": Words(), "user": TEXT, "privileged": BOOL, "working_dir": TEXT, "environment": Pairs(bare=True)}
)
SECRETS = ListOf(
    Section({**_keys(TEXT, "source target uid gid"), "mode": INT}, short=shorts.named("source"), required=("source",)),
    key=_of_secret,
)
BUILD = Section(
    {
        **_keys(TEXT, "dockerfile dockerfile_inline network target isolation"),
        **_keys(TEXTS, "entitlements cache_from cache_to platforms"),
        **_keys(BOOL, "no_cache pull privileged"),
        **_keys(LOOSE, "provenance sbom"),
        "context": PathOf(kept=is_remote),
        "args": Pairs(bare=True),
        "ssh": ListOf(TEXT, short=shorts.listed_pairs, of=dict),
        "labels": Pairs(),
        "additional_contexts": Contexts(),
        "shm_size": SIZE,
        "extra_hosts": HOSTS,
        "secrets": SECRETS,
        "tags": UNIQUE,
        "ulimits": ULIMITS,
    },
    short=shorts.named("context"),
)
MOUNT = Section(
    {
        "type": one_of("bind", "volume", "tmpfs", "cluster", "npipe", "image"),
        **_keys(TEXT, "source target consistency"),
        "read_only": BOOL,
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
    {**_keys(TEXT, "name mode host_ip protocol app_protocol"), "target": INT, "published": NUMBER_OR_TEXT},
    required=("target",),
    defaults={"mode": "ingress", "protocol": "tcp"},
)
DEVICE = Section(
    _keys(TEXT, "source target permissions"),
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
_DEPENDENCY = Section(
    {
        "condition": one_of("service_started", "service_healthy", "service_completed_successfully"),
        **_keys(BOOL, "restart required"),
    },
    required=("condition",),
    defaults={"required": True},
)
DEPENDS_ON = MapOf(_DEPENDENCY, short=shorts.depends_on, of=list, wanted="a list of services, or a mapping")
HEALTHCHECK = Section(
    {
        "disable": BOOL,
        "retries": INT,
        "test": ListOf(TEXT, replaced=True, short=shorts.health_test),
        **_keys(DURATION, "interval timeout start_period start_interval"),
    },
    finish=_health,
)
_UPDATE = Section(
    {
        **_keys(DURATION, "delay monitor"),
        "parallelism": INT,
        "failure_action": TEXT,
        "max_failure_ratio": FLOAT,
        "order": one_of("start-first", "stop-first"),
    }
)
_GENERIC = Section({"discrete_resource_spec": Section({"kind": TEXT, "value": INT})})
_RESERVATIONS = Section(
    {"cpus": FLOAT, "memory": SIZE, "generic_resources": ListOf(_GENERIC), "devices": ListOf(Section(_DEVICE))}
)
DEPLOY = Section(
    {
        **_keys(TEXT, "mode endpoint_mode"),
        "replicas": INT,
        "labels": Pairs(),
        **_keys(_UPDATE, "rollback_config update_config"),
        "resources": Section(
            {"limits": Section({"cpus": FLOAT, "memory": SIZE, "pids": INT}), "reservations": _RESERVATIONS}
        ),
        "restart_policy": Section({"condition": TEXT, "delay": DURATION, "max_attempts": INT, "window": DURATION}),
        "placement": Section(
            {"constraints": TEXTS, "preferences": ListOf(Section({"spread": TEXT})), "max_replicas_per_node": INT}
        ),
    }
)
_WATCH = Section(
    {
        **_keys(ONE_OR_MANY, "ignore include"),
        "path": PathOf(),
        "action": one_of("rebuild", "sync", "restart", "sync+restart", "sync+exec"),
        "target": TEXT,
        "exec": HOOK,
    },
    required=("path", "action"),
)
_SERVICE_NETWORK = Section(
    {
        **_keys(TEXTS, "aliases link_local_ips"),
        **_keys(TEXT, "interface_name ipv4_address ipv6_address mac_address"),
        **_keys(INT, "priority gw_priority"),
        "driver_opts": OPTIONS,
    }
)
_RATE = ListOf(Section({"path": TEXT, "rate": SIZE}))
BLKIO = Section(
    {
        **{f"device_{how}_{unit}": _RATE for how in ("read", "write") for unit in ("bps", "iops")},
        "weight": INT,
        "weight_device": ListOf(Section({"path": TEXT, "weight": INT})),
    },
    extensible=False,
)
_FORMS: Mapping[str, Form] = {
    "bool": BOOL,
    "duration": DURATION,
    "float": FLOAT,
    "int": INT,
    "list": UNIQUE,
    "one or many": ONE_OR_MANY,
    "pairs": Pairs(),
    "size": SIZE,
    "text": TEXT,
    "words": Words(),
}
"""Forms by their names in the table of options."""
SERVICE = Section(
    {
        **{name: _FORMS[option.compose] for name, option in CONTAINER_OPTIONS.items() if option.compose in _FORMS},
        **_keys(INT, "cpu_count scale"),
        **_keys(BOOL, "attach use_api_socket"),
        **_keys(UNIQUE, "external_links profiles"),
        "cpu_percent": FLOAT,
        "pull_refresh_after": TEXT,
        **_keys(ListOf(NUMBER_OR_TEXT, key=str), "expose group_add"),
        **_keys(SECRETS, "configs secrets"),
        **_keys(ListOf(HOOK), "post_start pre_stop"),
        "blkio_config": BLKIO,
        "build": BUILD,
        "cgroup": one_of("host", "private"),
        "credential_spec": Section(_keys(TEXT, "config file registry")),
        "depends_on": DEPENDS_ON,
        "deploy": DEPLOY,
        "develop": Section({"watch": ListOf(_WATCH)}),
        "devices": ListOf(DEVICE, key=lambda device: device.get("target")),
        "env_file": one_or_many(ENV_FILE),
        "environment": Pairs(bare=True),
        "extends": Section(
            _keys(TEXT, "service file"), short=shorts.named("service"), required=("service",), extensible=False
        ),
        "extra_hosts": HOSTS,
        "gpus": ListOf(Section(_DEVICE), short=shorts.all_gpus),
        "healthcheck": HEALTHCHECK,
        "label_file": one_or_many(PathOf()),
        "logging": Section({"driver": TEXT, "options": Pairs()}, same="driver"),
        "models": ANY,
        "networks": MapOf(
            _SERVICE_NETWORK, null=True, short=shorts.names, of=list, wanted="a list of names, or a mapping"
        ),
        "ports": ListOf(
            PORT,
            spread=shorts.ports,
            key=lambda p: (p.get("host_ip"), p.get("published"), p.get("target"), p.get("protocol")),
        ),
        "provider": Section({"type": TEXT, "options": ANY}, required=("type",)),
        "pull_policy": Scalar("text", (str,), lambda text: "missing" if text == "if_not_present" else text),
        "storage_opt": OPTIONS,
        "ulimits": ULIMITS,
        "volumes": ListOf(MOUNT, key=lambda volume: volume.get("target")),
    }
)
_POOL = Section({**_keys(TEXT, "subnet ip_range gateway"), "aux_addresses": MapOf(TEXT)})
_NAMED = {"name": TEXT, "external": Either(Section({"name": TEXT}), BOOL), "labels": Pairs()}
_DRIVEN = {**_NAMED, "driver": TEXT, "driver_opts": OPTIONS}
_GIVEN = {**_NAMED, "file": PathOf(), "environment": TEXT, "template_driver": TEXT}
NETWORK = Section(
    {
        **_DRIVEN,
        "ipam": Section({"driver": TEXT, "config": ListOf(_POOL), "options": MapOf(TEXT)}),
        **_keys(BOOL, "internal enable_ipv4 enable_ipv6 attachable"),
    },
    finish=shorts.external,
)
INCLUDE = Section(
    {**_keys(ONE_OR_MANY, "path env_file"), "project_directory": TEXT},
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
        "volumes": MapOf(Section(_DRIVEN, finish=shorts.external), null=True),
        "configs": MapOf(Section({**_GIVEN, "content": TEXT}, finish=shorts.external)),
        "secrets": MapOf(Section({**_GIVEN, "driver": TEXT, "driver_opts": OPTIONS}, finish=shorts.external)),
        "models": ANY,
    }
)
