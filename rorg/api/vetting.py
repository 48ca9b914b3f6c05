"""What a service may write into the manifests that it manages: nothing that gives more than it has itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from rorg.api.permissions import Caller, permitted
from rorg.errors import Forbidden
from rorg.manifest.documents import read_source
from rorg.manifest.profiles import built_in_profiles
from rorg.manifest.service import ServiceSpec
from rorg.manifest.variables import read_variables
from rorg.model.catalog import Catalog, Service

FIELDS = frozenset(
    {
        "type",
        "image",
        "command",
        "profile",
        "needs",
        "conflicts",
        "idle",
        "ready",
        "live",
        "exclusive",
        "may_request",
        "may_restart",
        "restart",
        "priority",
        "resources",
        "container",
    }
)
OPTIONS = frozenset(
    {
        "annotations",
        "cap_drop",
        "cpu_shares",
        "cpus",
        "entrypoint",
        "environment",
        "healthcheck",
        "hostname",
        "init",
        "mem_limit",
        "mem_reservation",
        "memswap_limit",
        "pids_limit",
        "read_only",
        "shm_size",
        "stdin_open",
        "stop_grace_period",
        "stop_signal",
        "tmpfs",
        "tty",
        "user",
        "working_dir",
    }
)
"""Options that reach nothing of the machine. The others come from a profile, which a person writes."""


def vet(caller: Caller, name: str, text: str, catalog: Catalog, root: Path, robot: str) -> None:
    """Raises Forbidden when a service, which the caller is, writes more than it may into a manifest that it manages,
    as that is read in the tree at `root` for a robot."""
    variables, _ = read_variables(root, robot)
    source, _ = read_source(text, Path(f"{name}.yaml"), f"{name}.yaml", Path(), variables)
    if source is None or not isinstance(source.spec, ServiceSpec):
        return  # that it is wrong is told where manifests are checked
    found = list(_beyond(source.spec, catalog.services[caller.service], catalog))
    found += ["labels"] if source.labels else []  # they say, for one, whose ROS nodes these are
    if found:
        raise Forbidden(
            f"change the Service '{name}'",
            f"{caller.service} may not give it {'; '.join(found)}",
            "a profile that a person writes, or asking a person",
        )


def _beyond(spec: ServiceSpec, manager: Service, catalog: Catalog) -> Iterator[str]:
    yield from sorted(spec.model_fields_set - FIELDS)
    if spec.type != "container":
        yield f"type {spec.type}"
    if spec.container is not None:
        yield from (f"container.{option}" for option in sorted(spec.container.model_fields_set - OPTIONS))
    for profile in spec.profile or ():
        if profile not in built_in_profiles() and not manager.manages(profile):
            yield f"the profile {profile}"
    if spec.priority > manager.priority:
        yield f"a priority above its own, {manager.priority}"
    requests = permitted(manager, "request", catalog)
    yield from _names("needs", [n.service for n in spec.needs], requests, manager, catalog)
    yield from _names("conflicts", spec.conflicts, set(), manager, catalog)
    yield from _names("may_request", spec.may_request, requests, manager, catalog)
    yield from _names("may_restart", spec.may_restart, permitted(manager, "restart", catalog), manager, catalog)


def _names(field: str, names: Iterable[str], allowed: set[str], manager: Service, catalog: Catalog) -> Iterator[str]:
    """Names that stand for more than what is allowed, or managed."""
    for name in names:
        members = catalog.members(name) or (name,)
        if not all(m in allowed or manager.manages(m) for m in members):
            yield f"{field} {name}"
