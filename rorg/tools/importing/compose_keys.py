"""Every key of the Compose specification, and what an import makes of it.

No key is dropped silently: each one that is not carried over unchanged has a sentence for the person who imports. The
keys are those of the specification's schema (compose-spec/schema/compose-spec.json).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from rorg.model.options import OF_COMPOSE


@dataclass(frozen=True, slots=True)
class Row:
    """What becomes of one key.

    carried: the same key of `container` or of the manifest has the same meaning. translated: something else means the
    same; the import notes it unless it is obvious. dropped: it does not affect what runs, and a note says so. refused:
    the import fails. consumed: the reader has already applied it, or it means nothing to a machine."""

    how: Literal["carried", "translated", "dropped", "refused", "consumed"]
    why: str = ""
    """Why it is dropped or refused; what it is translated to."""
    remedy: str = ""


CARRIED, CONSUMED = Row("carried"), Row("consumed")
Table = Mapping[str, Row]


def _to(where: str) -> Row:
    return Row("translated", where)


def _drop(why: str, remedy: str = "") -> Row:
    return Row("dropped", why, remedy)


def _refuse(why: str, remedy: str) -> Row:
    return Row("refused", why, remedy)


def _table(carried: str, rows: Table) -> Table:
    """A table in alphabetical order, from the names of the keys that are carried and the rows of all other keys."""
    return dict(sorted({**dict.fromkeys(carried.split(), CARRIED), **rows}.items()))


SWARM, WINDOWS = _drop("only a swarm reads it"), _drop("it is for Windows")
NO_SETTING = _drop("rorg's builds have no such setting")
PULLS = _drop("rorg pulls missing images when they are needed", "`rorg build`")
BY_DOCKER = "to build it with `docker build`, and name the image"
NO_RIGHTS = _refuse("rorg gives a build no extra privileges", BY_DOCKER)
NO_SWARM = _refuse("only a swarm keeps it", "a file")
MOUNTED, MODELS = _to("files that are mounted"), _refuse("rorg does not run models", "a service that runs the model")
COPIES, LIMITS = _to("a Service for each copy"), _to("spec.resources and limits of container")

SERVICE = _table(
    " ".join((*OF_COMPOSE, "env_file")),
    {
        "attach": _drop("rorg shows the output of every service", "`rorg logs -f SERVICE`"),
        "build": _to("a manifest of kind Image"),
        "command": _to("spec.command"),
        "configs": MOUNTED,
        **dict.fromkeys(("cpu_count", "cpu_percent", "credential_spec"), WINDOWS),
        "depends_on": _to("spec.needs"),
        "deploy": LIMITS,
        "develop": _drop("rorg has its own way to develop in a container", "`rorg dev SERVICE`"),
        "extends": CONSUMED,
        "external_links": _refuse(
            "rorg does not link to containers of other projects", "a network that both are in, `external: true`"
        ),
        "image": _to("spec.image"),
        "label_file": CONSUMED,
        "links": _to("spec.needs, and aliases in the networks of the other service"),
        "models": MODELS,
        "post_start": _refuse("rorg runs nothing in a started container", "to do it in the service's command"),
        "pre_stop": _refuse(
            "rorg runs nothing in a container before it stops", "stop_signal, which the program can handle"
        ),
        "profiles": _to("a Group for each"),
        "provider": _refuse("it runs a program of the host instead of a container", "a service on the process engine"),
        "pull_policy": PULLS,
        "pull_refresh_after": PULLS,
        "restart": _to("spec.restart"),
        "scale": COPIES,
        "secrets": MOUNTED,
        "use_api_socket": _refuse(
            "it gives away the engine's socket and a person's passwords", "a volume /var/run/docker.sock"
        ),
    },
)
BUILD = _table(
    "additional_contexts args cache_from context dockerfile target",
    {
        **dict.fromkeys(
            ("cache_to", "extra_hosts", "network", "provenance", "sbom", "shm_size", "ulimits"), NO_SETTING
        ),
        "dockerfile_inline": _to("a file beside the manifests"),
        "entitlements": NO_RIGHTS,
        "isolation": WINDOWS,
        "labels": _to("labels of the containers"),
        "no_cache": _drop("rorg builds what has changed", "`rorg build`"),
        "platforms": _to("platform"),
        "privileged": NO_RIGHTS,
        "pull": _drop("rorg pulls missing images"),
        "secrets": _refuse("rorg gives a build no secrets", BY_DOCKER),
        "ssh": _refuse("rorg gives a build no keys", BY_DOCKER),
        "tags": _drop("rorg tags an image with its own name and its content"),
    },
)
DEPLOY: Table = {
    **dict.fromkeys(("endpoint_mode", "labels", "mode", "placement", "rollback_config", "update_config"), SWARM),
    "replicas": COPIES,
    "resources": LIMITS,
    "restart_policy": _to("spec.restart"),
}
LIMIT: Table = {
    "cpus": _to("container.cpus"),
    "memory": _to("container.mem_limit"),
    "pids": _to("container.pids_limit"),
}
RESERVATION: Table = {
    "cpus": _to("spec.resources.cpu"),
    "devices": _to("container.gpus"),
    "generic_resources": SWARM,
    "memory": _to("spec.resources.memory, and container.mem_reservation"),
}
HEALTHCHECK = _table(
    "disable interval retries start_period test timeout",
    {"start_interval": _drop("rorg has no such setting", "a `ready` probe instead of a health check")},
)
SERVICE_NETWORK = _table(
    "aliases driver_opts ipv4_address ipv6_address link_local_ips mac_address",
    {
        **dict.fromkeys(("gw_priority", "priority"), _drop("the first network by name is the container's first")),
        "interface_name": _drop("rorg has no such setting", "driver_opts: {com.docker.network.endpoint.ifname: ...}"),
    },
)
NETWORK = _table(
    "attachable driver driver_opts enable_ipv6 external internal ipam labels name",
    {
        "enable_ipv4": _refuse(
            "rorg has no networks without IPv4", "to create it with `docker network create`, and set external: true"
        ),
    },
)
VOLUME: Table = dict.fromkeys(("driver", "driver_opts", "external", "labels", "name"), CARRIED)
FILE: Table = {
    "content": _to("a file beside the manifests"),
    **dict.fromkeys(("driver", "driver_opts", "external"), NO_SWARM),
    "environment": _to("a file beside the manifests"),
    "file": _to("a volume"),
    "labels": SWARM,
    "name": CONSUMED,
    "template_driver": _refuse("only a swarm fills it in", "a file that is already filled in"),
}
"""Of configs and secrets at the top."""
SERVICE_FILE: Table = {
    **dict.fromkeys(("gid", "uid"), _drop("a mounted file keeps its owner on the host")),
    "mode": _drop("a mounted file keeps its permissions on the host"),
    **dict.fromkeys(("source", "target"), _to("a volume")),
}
"""Of configs and secrets of a service."""
