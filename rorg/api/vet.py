"""What a service may write into the manifests that it manages: nothing with more rights than it has itself.

`vet` checks the words of a manifest before rorg reads any file that they name. `vet_rendered` compares the rendered
manifest, with its profiles, to the rights of the service itself.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from rorg.api.permissions import Caller, permitted
from rorg.api.rights import exceeding, network_of
from rorg.errors import Forbidden, Invalid, Refused
from rorg.manifest.documents import read_source
from rorg.manifest.load import Loaded, load
from rorg.manifest.models import API_VERSION
from rorg.manifest.profiles import COMMON, built_in_profiles
from rorg.manifest.service import ServiceSpec
from rorg.manifest.variables import Variables, fill, read_variables
from rorg.manifest.yaml_source import read_yaml
from rorg.model.catalog import Catalog, Service
from rorg.model.diagnostics import collected
from rorg.model.probe import Probe
from rorg.model.run_directory import socket_folder

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
"""Options that reach nothing of the machine. Other options must come from a profile, which a person writes."""

WITHIN = frozenset(("exec", "file", "log", "delay", "completed", "engine"))
"""Probes that do not use the network of this machine."""
MOST_TOLD = 5
"""Things that one error names."""


def vet(
    caller: Caller, name: str, path: Path, text: str, *, before: str, catalog: Catalog, root: Path, robot: str
) -> None:
    """Checks the words of a manifest that a service writes at `path`, in place of the text `before`, without reading a
    file that it names. Raises Forbidden for what the service may not write, and Invalid for mistakes."""
    variables, _ = collected(read_variables(root, robot))
    unknown = sorted(_variables_of(text, variables) - _variables_of(before, variables))
    _refuse(caller, name, [f"the variable {variable}" for variable in unknown])
    source, mistakes = read_source(text, path, str(path.relative_to(root)), root, variables)
    if source is None or not isinstance(source.spec, ServiceSpec):
        raise Invalid(f"change the Service '{name}'", "; ".join(map(str, mistakes[:MOST_TOLD])))
    excess = list(_beyond(source.spec, catalog.services[caller.service], catalog))
    excess += ["labels"] if source.labels else []  # they say, for example, whose ROS nodes these are
    _refuse(caller, name, excess)


def vet_rendered(
    caller: Caller, name: str, path: Path, *, before: Loaded, after: Loaded, catalog: Catalog, root: Path, robot: str
) -> None:
    """Compares the rights that a manifest at `path` gives to those of the service that writes it, to those that it gave
    before, and to those of the profiles that a person wrote for it. Raises Forbidden."""
    if after.catalog is None or after.sources is None:
        raise Refused(f"change the Service '{name}'", "other manifests of the tree have errors", "to ask a person")
    known = before.read.services if before.read else {}
    manager, service = catalog.services[caller.service], after.catalog.services[name]
    others = [one for one in (known.get(caller.service), known.get(name)) if one]
    profiles = [p for p in after.sources["Service"][name].spec.profile or () if p not in built_in_profiles()]
    grant = _grant(name, path, profiles, root, robot) if profiles else Service(name)
    _refuse(caller, name, list(_more(service, others, grant, manager, catalog)))


def _refuse(caller: Caller, name: str, excess: Collection[str]) -> None:
    if excess:
        raise Forbidden(
            f"change the Service '{name}'",
            f"{caller.service} may not give it {'; '.join([*excess][:MOST_TOLD])}",
            "to ask a person, or use a profile that a person writes",
        )


def _variables_of(text: str, variables: Variables) -> set[str]:
    """All variables that a manifest names, declared or not."""
    document, _ = read_yaml(text, "")
    filled = fill(document, variables)[0].filled if document else {}
    return {use.name for uses in filled.values() for use in uses}


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
    """Names that stand for services which are neither allowed nor managed."""
    for name in names:
        members = catalog.members(name) or (name,)
        if not all(m in allowed or manager.manages(m) for m in members):
            yield f"{field} {name}"


# -- as it is rendered -----------------------------------------------------------------------------------------


def _grant(name: str, path: Path, profiles: list[str], root: Path, robot: str) -> Service:
    """The options that these profiles give to a service that declares nothing else."""
    said = {"image": "none", "profile": profiles}
    text = json.dumps({"apiVersion": API_VERSION, "kind": "Service", "metadata": {"name": name}, "spec": said})
    catalog = load(root, {path: text}, robot=robot).read
    return catalog.services.get(name, Service(name)) if catalog else Service(name)


def _granted(grant: Service) -> set[str]:
    """The options that a person decided in a profile: those that it sets, and those of the built-in `common` that it
    leaves out."""
    if grant.spec is None:
        return set()
    shipped: set[str] = built_in_profiles()[COMMON].spec.container.model_fields_set
    decided = {path.partition(".")[0] for path in grant.origins.keys() - set(grant.defaults)}
    return decided | (shipped - grant.spec.keys())


def _more(service: Service, others: list[Service], grant: Service, manager: Service, catalog: Catalog) -> Iterator[str]:
    """Rights of a service that none of the others has."""
    folder = socket_folder(service.name)
    spec = dict(service.options)
    spec["volumes"] = [v for v in spec.get("volumes", ()) if v != f"{folder}:{folder}:ro"]
    specs = [other.options for other in others]
    yield from (f"container.{o}" for o in exceeding(spec, specs, grant.options, _granted(grant)))
    allowed = permitted(manager, "request", catalog).union(*(other.needs for other in (*others, grant)))
    yield from (f"needs {need}" for need in service.needs if need not in allowed and not manager.manages(need))
    held = {resource for other in (*others, grant) for resource in other.exclusive}
    yield from (f"exclusive {resource}" for resource in service.exclusive if resource not in held)
    known = {probe for other in (*others, grant) for probe in (other.ready, other.live)}
    if not any(network_of(one) == "host" for one in specs):
        for role, probe in (("ready", service.ready), ("live", service.live)):
            if probe not in known and _asks_outside(probe):
                yield f"a probe of the network ({role})"


def _asks_outside(probe: Probe | None) -> bool:
    parts = (probe.parts or (probe,)) if probe else ()
    return any(part.kind not in WITHIN for part in parts)
