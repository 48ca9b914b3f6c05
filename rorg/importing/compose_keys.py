"""Every key of the Compose specification, and what an import makes of it. Nothing is dropped in silence: what is not
carried over as it is has a sentence for whoever imports.

The keys are those of the specification's schema (compose-spec/schema/compose-spec.json).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from rorg.model.options import OF_COMPOSE


@dataclass(frozen=True, slots=True)
class Row:
    """What becomes of one key.

    carried: the same key of `container`, or of the manifest, with the same meaning. translated: something else that
    means the same, told where it is not plain. dropped: it does not matter to what runs, and a note says so. refused:
    the import ends. consumed: the reader has done it already, or it says nothing to a machine."""

    how: Literal["carried", "translated", "dropped", "refused", "consumed"]
    why: str = ""
    """Of what is dropped or refused; of what is translated, to what."""
    remedy: str = ""


CARRIED, CONSUMED = Row("carried"), Row("consumed")


def _to(where: str) -> Row:
    return Row("translated", where)


def _drop(why: str, remedy: str = "") -> Row:
    return Row("dropped", why, remedy)


def _refuse(why: str, remedy: str) -> Row:
    return Row("refused", why, remedy)


SWARM = "only a swarm reads it"
WINDOWS = "it is for Windows"
BUILDER = "rorg's builds have no such setting"

SERVICE: Mapping[str, Row] = {
    **dict.fromkeys(OF_COMPOSE, CARRIED),
    "attach": _drop("rorg shows the output of every service", "`rorg logs -f SERVICE`"),
    "build": _to("a manifest of kind Image"),
    "command": _to("spec.command"),
    "configs": _to("files that are mounted"),
    "cpu_count": _drop(WINDOWS),
    "cpu_percent": _drop(WINDOWS),
    "credential_spec": _drop(WINDOWS),
    "depends_on": _to("spec.needs"),
    "deploy": _to("spec.resources and limits of container"),
    "develop": _drop("rorg develops otherwise", "`rorg dev SERVICE`"),
    "env_file": CARRIED,
    "extends": CONSUMED,
    "external_links": _refuse(
        "rorg links no containers of other projects", "a network that both are in, `external: true`"
    ),
    "image": _to("spec.image"),
    "label_file": CONSUMED,
    "links": _to("spec.needs, and aliases in the networks of the other service"),
    "models": _refuse("rorg runs no models by themselves", "a service that runs the model"),
    "post_start": _refuse("rorg runs nothing in a container that has started", "doing it in the service's command"),
    "pre_stop": _refuse(
        "rorg runs nothing in a container before it stops", "stop_signal, which the program can handle"
    ),
    "profiles": _to("a Group for each"),
    "provider": _refuse("it runs a program of the machine in place of a container", "a service on the process engine"),
    "pull_policy": _drop("rorg pulls what is missing when it is needed", "`rorg build`"),
    "pull_refresh_after": _drop("rorg pulls what is missing when it is needed", "`rorg build`"),
    "restart": _to("spec.restart"),
    "scale": _to("a Service for each copy"),
    "secrets": _to("files that are mounted"),
    "use_api_socket": _refuse("it gives the engine's socket and a person's passwords", "a volume /var/run/docker.sock"),
}
BUILD: Mapping[str, Row] = {
    "additional_contexts": CARRIED,
    "args": CARRIED,
    "cache_from": CARRIED,
    "cache_to": _drop(BUILDER),
    "context": CARRIED,
    "dockerfile": CARRIED,
    "dockerfile_inline": _to("a file beside the manifests"),
    "entitlements": _refuse("rorg gives a build no more rights", "building it by `docker build`, and naming the image"),
    "extra_hosts": _drop(BUILDER),
    "isolation": _drop(WINDOWS),
    "labels": _to("labels of the containers"),
    "network": _drop(BUILDER),
    "no_cache": _drop("rorg builds what has changed", "`rorg build`"),
    "platforms": _to("platform"),
    "privileged": _refuse("rorg gives a build no more rights", "building it by `docker build`, and naming the image"),
    "provenance": _drop(BUILDER),
    "pull": _drop("rorg pulls what is missing"),
    "sbom": _drop(BUILDER),
    "secrets": _refuse("rorg gives a build no secrets", "building it by `docker build`, and naming the image"),
    "shm_size": _drop(BUILDER),
    "ssh": _refuse("rorg gives a build no keys", "building it by `docker build`, and naming the image"),
    "tags": _drop("rorg tags an image by its own name and its content"),
    "target": CARRIED,
    "ulimits": _drop(BUILDER),
}
DEPLOY: Mapping[str, Row] = {
    "endpoint_mode": _drop(SWARM),
    "labels": _drop(SWARM),
    "mode": _drop(SWARM),
    "placement": _drop(SWARM),
    "replicas": _to("a Service for each copy"),
    "resources": _to("spec.resources and limits of container"),
    "restart_policy": _to("spec.restart"),
    "rollback_config": _drop(SWARM),
    "update_config": _drop(SWARM),
}
RESOURCES: Mapping[str, Row] = {
    "limits.cpus": _to("container.cpus"),
    "limits.memory": _to("container.mem_limit"),
    "limits.pids": _to("container.pids_limit"),
    "reservations.cpus": _to("spec.resources.cpu"),
    "reservations.devices": _to("container.gpus"),
    "reservations.generic_resources": _drop(SWARM),
    "reservations.memory": _to("spec.resources.memory, and container.mem_reservation"),
}
HEALTHCHECK: Mapping[str, Row] = {
    **dict.fromkeys(("disable", "interval", "retries", "start_period", "test", "timeout"), CARRIED),
    "start_interval": _drop("rorg has no setting for it", "a `ready` probe in place of a health check"),
}
SERVICE_NETWORK: Mapping[str, Row] = {
    "aliases": CARRIED,
    "driver_opts": CARRIED,
    "gw_priority": _drop("the first network by name is the first of the container"),
    "interface_name": _drop("rorg has no setting for it", "driver_opts: {com.docker.network.endpoint.ifname: ...}"),
    "ipv4_address": CARRIED,
    "ipv6_address": CARRIED,
    "link_local_ips": CARRIED,
    "mac_address": CARRIED,
    "priority": _drop("the first network by name is the first of the container"),
}
NETWORK: Mapping[str, Row] = {
    "attachable": CARRIED,
    "driver": CARRIED,
    "driver_opts": CARRIED,
    "enable_ipv4": _refuse(
        "rorg has no networks without IPv4", "making it by `docker network create`, and external: true"
    ),
    "enable_ipv6": CARRIED,
    "external": CARRIED,
    "internal": CARRIED,
    "ipam": CARRIED,
    "labels": CARRIED,
    "name": CARRIED,
}
VOLUME: Mapping[str, Row] = {
    **dict.fromkeys(("driver", "driver_opts", "external", "labels", "name"), CARRIED),
}
FILE: Mapping[str, Row] = {
    "content": _to("a file beside the manifests"),
    "driver": _refuse("only a swarm keeps it", "a file"),
    "driver_opts": _refuse("only a swarm keeps it", "a file"),
    "environment": _to("a file beside the manifests"),
    "external": _refuse("only a swarm keeps it", "a file"),
    "file": _to("a volume"),
    "labels": _drop(SWARM),
    "name": CONSUMED,
    "template_driver": _refuse("only a swarm fills it in", "a file that is filled in already"),
}
"""Of configs and secrets at the top."""
SERVICE_FILE: Mapping[str, Row] = {
    "gid": _drop("a mounted file belongs to whoever it belongs to on the machine"),
    "mode": _drop("a mounted file has the permissions that it has on the machine"),
    "source": _to("a volume"),
    "target": _to("a volume"),
    "uid": _drop("a mounted file belongs to whoever it belongs to on the machine"),
}
"""Of configs and secrets of a service."""
TOP: Mapping[str, Row] = {
    "configs": _to("files that are mounted"),
    "include": CONSUMED,
    "models": _refuse("rorg runs no models by themselves", "a service that runs the model"),
    "name": _to("names of containers, networks and volumes"),
    "networks": _to("manifests of kind Network"),
    "secrets": _to("files that are mounted"),
    "services": _to("manifests of kind Service"),
    "version": CONSUMED,
    "volumes": _to("manifests of kind Volume"),
}
TABLES: Mapping[str, Mapping[str, Row]] = {
    "top": TOP,
    "service": SERVICE,
    "build": BUILD,
    "deploy": DEPLOY,
    "resources": RESOURCES,
    "healthcheck": HEALTHCHECK,
    "service network": SERVICE_NETWORK,
    "network": NETWORK,
    "volume": VOLUME,
    "config or secret": FILE,
    "config or secret of a service": SERVICE_FILE,
}
