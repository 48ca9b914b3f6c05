"""The sections of a Compose file: what a service, a network, a volume, a config, a secret may say."""

from __future__ import annotations

from collections.abc import Mapping

from rorg.compose import keys, shorts
from rorg.compose.form import ANY, Form
from rorg.compose.forms import ListOf, MapOf, Pairs, Section, Words
from rorg.compose.key_forms import Changed, Either
from rorg.compose.keys import ONE_OR_MANY, OPTIONS, UNIQUE
from rorg.compose.scalars import BOOL, DURATION, FLOAT, INT, NUMBER_OR_TEXT, SIZE, TEXT, PathOf, Scalar, one_of
from rorg.model import options

FORMS: Mapping[str, Form] = {
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
        **{name: FORMS[option.compose] for name, option in options.OPTIONS.items() if option.compose in FORMS},
        "attach": BOOL,
        "blkio_config": keys.BLKIO,
        "build": keys.BUILD,
        "cgroup": one_of("host", "private"),
        "configs": keys.SECRETS,
        "cpu_count": INT,
        "cpu_percent": FLOAT,
        "credential_spec": Section({"config": TEXT, "file": TEXT, "registry": TEXT}),
        "depends_on": keys.DEPENDS_ON,
        "deploy": keys.DEPLOY,
        "develop": keys.DEVELOP,
        "devices": ListOf(keys.DEVICE, key=lambda device: device.get("target")),
        "env_file": ListOf(keys.ENV_FILE, single=True),
        "environment": Pairs(bare=True),
        "expose": ListOf(NUMBER_OR_TEXT, key=str),
        "extends": keys.EXTENDS,
        "external_links": UNIQUE,
        "extra_hosts": keys.HOSTS,
        "gpus": Changed(shorts.all_gpus, keys.GPUS, str),
        "group_add": ListOf(NUMBER_OR_TEXT, key=str),
        "healthcheck": keys.HEALTHCHECK,
        "label_file": ListOf(PathOf(), single=True),
        "logging": keys.LOGGING,
        "models": ANY,
        "networks": keys.NETWORKS,
        "ports": ListOf(
            keys.PORT,
            spread=shorts.ports,
            key=lambda p: (p.get("host_ip"), p.get("published"), p.get("target"), p.get("protocol")),
        ),
        "post_start": ListOf(keys.HOOK),
        "pre_stop": ListOf(keys.HOOK),
        "profiles": UNIQUE,
        "provider": keys.PROVIDER,
        "pull_policy": Scalar("text", (str,), lambda text: "missing" if text == "if_not_present" else text),
        "pull_refresh_after": TEXT,
        "scale": INT,
        "secrets": keys.SECRETS,
        "storage_opt": OPTIONS,
        "ulimits": keys.ULIMITS,
        "use_api_socket": BOOL,
        "volumes": ListOf(keys.MOUNT, key=lambda volume: volume.get("target")),
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
