"""A tree of manifests to a Catalog, or to everything that is wrong with it: `load(root)`."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, replace
from pathlib import Path
from typing import Any

from rorg.errors import Invalid
from rorg.manifest.declarations import policy_of, requests_of
from rorg.manifest.documents import Source, read_tree, unexpected
from rorg.manifest.idling import check_idling
from rorg.manifest.images import images_of
from rorg.manifest.inputs import Inputs, inputs
from rorg.manifest.joining import check_shared_memory, join, told_of_processes
from rorg.manifest.profiles import COMMON, Merged, built_in_profiles, merge_profiles
from rorg.manifest.programs import check_programs, of_this_machine
from rorg.manifest.references import check_conflicts, check_container_names, check_cycles, check_spelling, expand_groups
from rorg.manifest.render import render
from rorg.manifest.secrets import secrets_of, unread_secrets
from rorg.manifest.used_objects import check_default, joined, misspelt, objects_of
from rorg.manifest.validation.run import validate
from rorg.manifest.variables import noted
from rorg.model.catalog import DEVELOPER, EVERY, Catalog, Group, Image, Service
from rorg.model.diagnostics import Diagnostic, Where, few_suggestions, nearest
from rorg.model.image_names import stems
from rorg.model.objects import EngineObject
from rorg.model.policy import Policy
from rorg.model.units import counted


@dataclass(frozen=True)
class Loaded:
    """What came of reading a tree. `catalog` is None when there are errors; warnings let it pass."""

    catalog: Catalog | None
    diagnostics: tuple[Diagnostic, ...] = ()
    read: Catalog | None = None
    """As much of it as could be read, whether it is good or not: its secrets are in no message either."""
    sources: Mapping[str, Mapping[str, Source]] | None = None
    """The manifests that the Catalog was made of, by kind and name."""

    @property
    def errors(self) -> list[Diagnostic]:
        return [d for d in self.diagnostics if d.severity == "error"]


def load(
    root: Path,
    edits: Mapping[Path, str | None] | None = None,
    found: Callable[[Inputs], None] = lambda _: None,
    engine: str = "",
    robot: str = "",
) -> Loaded:
    """Reads and checks a whole tree, with the files of `edits` in place of those on the disk (None: gone). All errors
    at once, sorted by place; nothing is half accepted. `found` is told what else will be read, before it is. `engine`:
    the name of the one that the tree is for; empty where that is not known, and then nothing is checked for it.
    `robot`: whose overlay is laid over it; empty for the base alone.

    Raises Invalid when `root` is no readable directory or holds no manifest at all, and nothing else: what nobody
    thought of is an error of the tree too, and the robot goes on with the last good one.
    """
    if not os.path.isdir(root):
        raise Invalid(f"read manifests in {root}", "no such directory", "the directory that holds services/")
    try:
        with few_suggestions():
            loaded = _load(root, edits, found, engine, robot)
    except OSError as error:
        raise Invalid(f"read manifests in {root}", str(error)) from error
    except Invalid:
        raise
    except Exception as bug:
        loaded = Loaded(None, (unexpected(Where(str(root)), bug),))
    return loaded


def _load(
    root: Path, edits: Mapping[Path, str | None] | None, found: Callable[[Inputs], None], engine: str, robot: str
) -> Loaded:
    sources, diagnostics, broken = read_tree(root, edits, robot)
    if not sources and not diagnostics:
        raise Invalid(f"read manifests in {root}", "no manifests there", "a directory with services/*.yaml")
    by_kind, more = _by_kind(sources)
    diagnostics += more + check_spelling(sources)
    found(inputs(root, by_kind))
    catalog, more = _catalog(by_kind, broken, engine)
    diagnostics = noted([*diagnostics, *more], [source.document for source in sources])
    diagnostics += _validated(catalog, by_kind, refused=any(d.severity == "error" for d in diagnostics))
    if any(d.severity == "error" for d in diagnostics):
        unread = unread_secrets(root, edits or {}, broken)
        return Loaded(None, _told(diagnostics), replace(catalog, services={**unread, **catalog.services}))
    diagnostics += _misnamed(sources)
    catalog = replace(catalog, fingerprint=fingerprint(catalog))
    return Loaded(catalog, _told(diagnostics), catalog, by_kind)


def _told(diagnostics: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Sorted by place, errors before warnings where they are too many; and how many more there are."""
    found = sorted(set(diagnostics))
    if len(found) <= MOST_TOLD:
        return tuple(found)
    first = sorted(found, key=lambda d: d.severity)[:MOST_TOLD]
    last = first[-1]
    more = f"{len(found) - MOST_TOLD} more mistakes are not listed"
    return (*sorted(first), Diagnostic(last.where, more, "fixing these first", last.severity))


def _validated(catalog: Catalog, by_kind: Mapping[str, dict[str, Source]], refused: bool) -> list[Diagnostic]:
    """What the checks of the whole say; only errors of a tree that is refused anyway: who is missing in it may be
    what its others need."""
    found = validate(catalog, by_kind)
    return [d for d in found if d.severity == "error"] if refused else found


def _misnamed(sources: Iterable[Source]) -> list[Diagnostic]:
    """Files that are called otherwise than what they declare: one of both may be a typing error."""
    return [
        Diagnostic(
            s.where("metadata", "name"),
            f"the {s.kind} '{s.name}' is in a file called '{s.path.name}'",
            f"'{s.path.stem}', or renaming the file",
            "warning",
        )
        for s in sources
        if s.path.stem not in stems(s.name)
    ]


def load_or_raise(root: Path, engine: str = "", robot: str = "") -> Catalog:
    """The Catalog of a tree, or Invalid with every diagnostic in its message."""
    return usable(root, load(root, engine=engine, robot=robot))


def usable(root: Path, loaded: Loaded) -> Catalog:
    """What was loaded, or Invalid."""
    if loaded.catalog is None:
        raise unusable(root, loaded.errors)
    return loaded.catalog


def unusable(root: Path, errors: Sequence[Diagnostic]) -> Invalid:
    """Why the tree cannot be used."""
    lines = "\n".join(map(str, errors))
    return Invalid(
        f"use the manifests in {root}",
        f"{counted(len(errors), 'error')}\n{lines}\n",
        "fixing them, then `rorg validate`",
    )


MOST_TOLD = 200
"""Mistakes of a tree that are listed."""
UNTOLD = ("where", "origins", "fingerprint", "joins")
"""What is no part of what a tree declares, or follows from the rest."""
LATER = (
    *("stand_ins", "cache_from", "inline", "networks", "volumes", "devices", "unplugged", "ros", "parts"),
    *("purge_shm", "prewarm", "connected"),
)
"""What earlier versions did not know: a tree without it has the fingerprint that it had."""


def fingerprint(catalog: Catalog) -> str:
    """Of all that a tree declares, wherever it is written."""

    def content(value: Any) -> dict[str, Any]:
        told = (f.name for f in fields(value) if f.name not in UNTOLD and not (f.name in LATER and _unsaid(value, f)))
        return {name: getattr(value, name) for name in told}

    return hashlib.sha256(json.dumps(catalog, default=content, sort_keys=True).encode()).hexdigest()[:16]


def _unsaid(value: Any, field: Field[Any]) -> bool:
    """It is as where nothing is declared."""
    factory = field.default_factory
    return bool(getattr(value, field.name) == (field.default if factory is MISSING else factory()))


def _by_kind(sources: Iterable[Source]) -> tuple[dict[str, dict[str, Source]], list[Diagnostic]]:
    """Sources by kind and name. Services and groups share one namespace, since a request names either."""
    found: dict[str, dict[str, Source]] = {}
    diagnostics: list[Diagnostic] = []
    for source in sources:
        rivals = [k for k in ("Service", "Group") if source.kind in ("Service", "Group")] or [source.kind]
        first = next((found[k][source.name] for k in rivals if source.name in found.get(k, {})), None)
        where = source.where("metadata", "name")
        if first:
            diagnostics.append(
                Diagnostic(
                    where,
                    f"the name '{source.name}' is taken by a {first.kind} at {first.where('metadata', 'name')}",
                    "another name",
                )
            )
        elif source.name == DEVELOPER and (
            source.kind == "Group" or (source.kind == "Service" and source.spec.type != "meta")
        ):
            diagnostics.append(Diagnostic(where, "'developer' is the built-in meta-service", "another name"))
        elif source.kind == "Policy" and found.get("Policy"):
            other = next(iter(found["Policy"].values()))
            diagnostics.append(Diagnostic(where, "a second Policy", f"merging it into {other.document.file}"))
        else:
            found.setdefault(source.kind, {})[source.name] = source
    return found, diagnostics


def _catalog(
    by_kind: Mapping[str, dict[str, Source]], broken: set[str], engine: str
) -> tuple[Catalog, list[Diagnostic]]:
    profiles = {**built_in_profiles(), **by_kind.get("Profile", {})}
    merged, diagnostics = merge_profiles(profiles)
    policy: Any = next((s.spec for s in by_kind.get("Policy", {}).values()), None)
    services: dict[str, Service] = {DEVELOPER: Service(DEVELOPER, meta=True, description="a person")}
    for name, source in by_kind.get("Service", {}).items():
        wanted = source.spec.profile or ()
        diagnostics += _unknown_profiles(source, wanted, {*profiles, *broken})
        services[name], found = _rendered(source, merged.of(wanted), policy, engine)
        diagnostics += found
    groups, found = expand_groups(by_kind.get("Group", {}), services, broken)
    diagnostics += found
    known = {*services, *groups, *broken}
    diagnostics += _resolve_all(by_kind.get("Service", {}), services, groups, known, engine)
    diagnostics += check_container_names(services, by_kind.get("Service", {}))
    diagnostics += check_idling(services, by_kind.get("Service", {}))
    diagnostics += check_cycles(services, by_kind.get("Service", {}))
    diagnostics += _unknown_permitted(services, by_kind.get("Service", {}), known)
    requests, found = requests_of(by_kind.get("Request", {}), known, {*services, *broken})
    diagnostics += found
    images, of_images = _images(by_kind, services)
    services, networks, volumes, found = _objects(by_kind, services, engine)
    diagnostics += found
    stated = policy_of(policy) if policy else Policy()
    catalog = Catalog(services, groups, images, networks, volumes, requests, stated)
    if not any(d.severity == "error" for d in diagnostics):
        diagnostics += check_conflicts(catalog, by_kind.get("Service", {}))
    diagnostics += of_images
    diagnostics += check_programs(services, by_kind.get("Service", {}), images, engine)
    return catalog, diagnostics


def _unknown_profiles(source: Source, names: Iterable[str], known: set[str]) -> Iterator[Diagnostic]:
    for index, name in enumerate(names):
        if name not in known:
            at = ("spec", "profile", index)
            where = source.where(*at) if at in source.document.values else source.where("spec", "profile")
            yield Diagnostic(where, f"unknown profile '{name}'", nearest(name, known))


def _unknown_permitted(
    services: Mapping[str, Service], sources: Mapping[str, Source], known: set[str]
) -> Iterator[Diagnostic]:
    """Names that mean nothing, in what services may do."""
    for name, source in sources.items():
        for field in ("may_request", "may_restart", "may_act_for"):
            for index, other in enumerate(getattr(services[name], field)):
                if other not in known and (field, other) != ("may_act_for", EVERY):
                    where = source.where("spec", field, index)
                    yield Diagnostic(where, f"unknown service '{other}'", nearest(other, known))


def _objects(
    by_kind: Mapping[str, dict[str, Source]], services: Mapping[str, Service], engine: str
) -> tuple[dict[str, Service], dict[str, EngineObject], dict[str, EngineObject], list[Diagnostic]]:
    """The services by what the engine calls their networks and volumes; and these."""
    networks, found = objects_of("network", by_kind.get("Network", {}), engine)
    volumes, more = objects_of("volume", by_kind.get("Volume", {}), engine)
    sources = by_kind.get("Service", {})
    found += [*more, *check_default(services, sources, networks)]
    services = {n: joined(s, networks, volumes) for n, s in services.items()}
    return services, networks, volumes, [*found, *misspelt(services, sources, networks, volumes)]


def _images(
    by_kind: Mapping[str, dict[str, Source]], services: Mapping[str, Service]
) -> tuple[dict[str, Image], list[Diagnostic]]:
    images, diagnostics = images_of(by_kind.get("Image", {}), services)
    images, found = secrets_of(services, images, by_kind.get("Service", {}))
    return images, [*diagnostics, *found]


def _rendered(source: Source, profile: Merged, policy: Any, engine: str) -> tuple[Service, list[Diagnostic]]:
    try:
        return render(source, profile, policy, engine)
    except Exception as bug:
        return Service(source.name), [unexpected(source.where("metadata", "name"), bug)]


def _resolve_all(
    sources: Mapping[str, Source],
    services: dict[str, Service],
    groups: Mapping[str, Group],
    known: set[str],
    engine: str,
) -> list[Diagnostic]:
    """Fills in what services say of each other, in place."""
    diagnostics: list[Diagnostic] = []
    for name, source in sources.items():
        joined, of_joins = join(source, services[name], services, groups, known)
        services[name], found = _resolve(source, joined, groups, known)
        diagnostics += of_joins + found
    more = told_of_processes if of_this_machine(engine) else check_shared_memory
    return [*diagnostics, *more(services, sources)]


def _resolve(
    source: Source, service: Service, groups: Mapping[str, Group], known: set[str]
) -> tuple[Service, list[Diagnostic]]:
    """Names in `needs` and `conflicts`: unknown ones are errors, groups become their members."""
    diagnostics = []
    resolved: dict[str, tuple[str, ...]] = {}
    for field in ("needs", "conflicts"):
        names: list[str] = []
        written = [getattr(n, "service", n) for n in getattr(source.spec, field)]
        for name in getattr(service, field):
            where = (
                source.where("spec", field, written.index(name)) if name in written else source.where("spec", "profile")
            )
            if field == "conflicts" and (name == service.name or name in service.needs):
                what = "itself" if name == service.name else f"'{name}', which it needs"
                diagnostics.append(Diagnostic(where, f"'{service.name}' conflicts with {what}", "dropping one of them"))
            elif name not in known:
                by = "" if name in written else f" (by profile '{', '.join(source.spec.profile or [COMMON])}')"
                diagnostics.append(Diagnostic(where, f"{field} unknown service '{name}'{by}", nearest(name, known)))
            names += [m for m in groups[name].services if m != service.name] if name in groups else [name]
        resolved[field] = tuple(dict.fromkeys(names))
    follows = {m for n in service.restarts_with for m in (groups[n].services if n in groups else [n])} - {service.name}
    needs, conflicts = resolved["needs"], resolved["conflicts"]
    return replace(service, needs=needs, conflicts=conflicts, restarts_with=tuple(sorted(follows))), diagnostics
