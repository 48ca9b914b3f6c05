"""Loads a tree of manifests into a Catalog, or returns everything that is wrong with it: `load(root)`."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, replace
from pathlib import Path
from typing import Any

from rorg.errors import Invalid
from rorg.manifest.documents import Source, read_tree, unexpected
from rorg.manifest.images import images_of
from rorg.manifest.inputs import Inputs, inputs
from rorg.manifest.joining import check_shared_memory, join, told_of_processes
from rorg.manifest.machines import belonging, check_crossings, machines_of
from rorg.manifest.profiles import Merged, built_in_profiles, merge_profiles
from rorg.manifest.programs import check_programs, of_this_machine
from rorg.manifest.references import (
    check_conflicts,
    check_container_names,
    check_cycles,
    check_spelling,
    expand_groups,
    requests_of,
    resolve,
    unknown_permitted,
    unknown_profiles,
)
from rorg.manifest.render import policy_of, render
from rorg.manifest.secrets import secrets_of, unread_secrets
from rorg.manifest.used_objects import check_default, joined, misspelt, objects_of
from rorg.manifest.validation.run import validate
from rorg.manifest.variables import noted
from rorg.model.catalog import DEVELOPER, Catalog, Group, Request, Service
from rorg.model.diagnostics import HINT, Diagnostic, Reading, Where, collected, few_suggestions
from rorg.model.image_names import stem, stems
from rorg.model.policy import Policy
from rorg.model.units import counted


@dataclass(frozen=True)
class Loaded:
    """The result of reading a tree. `catalog` is None if there are errors; warnings do not prevent it."""

    catalog: Catalog | None
    diagnostics: tuple[Diagnostic, ...] = ()
    read: Catalog | None = None
    """Everything that could be read, valid or not, so that its secrets can be masked in messages."""
    sources: Mapping[str, Mapping[str, Source]] | None = None
    """The manifests behind the Catalog, by kind and name."""

    @property
    def errors(self) -> list[Diagnostic]:
        return [d for d in self.diagnostics if d.severity == "error"]


def load(
    root: Path,
    edits: Mapping[Path, str | None] | None = None,
    on_inputs: Callable[[Inputs], None] = lambda _: None,
    engine: str = "",
    robot: str = "",
) -> Loaded:
    """Reads and checks a whole tree.

    `edits` replace files on disk (None: deleted). `on_inputs` gets the other files that the tree depends on, before
    they are read. `engine` is the name of the engine that will run the tree; if it is empty, engine-specific checks are
    skipped. `robot` selects an overlay; empty means the base alone.

    Returns all errors together, sorted by place; a tree is accepted as a whole or not at all. Raises only Invalid, if
    `root` is not a readable directory or holds no manifests. Unexpected exceptions become errors of the tree, and the
    robot keeps its last good one.
    """
    if not os.path.isdir(root):
        raise Invalid(f"read manifests in {root}", "no such directory", "the directory that holds services/")
    try:
        with few_suggestions():
            loaded = _load(root, edits, on_inputs, engine, robot)
    except OSError as error:
        raise Invalid(f"read manifests in {root}", str(error)) from error
    except Invalid:
        raise
    except Exception as bug:
        loaded = Loaded(None, (unexpected(Where(str(root)), bug),))
    return loaded


def _load(
    root: Path, edits: Mapping[Path, str | None] | None, on_inputs: Callable[[Inputs], None], engine: str, robot: str
) -> Loaded:
    (sources, broken), diagnostics = collected(read_tree(root, edits, robot))
    if not sources and not diagnostics:
        raise Invalid(f"read manifests in {root}", "no manifests there", "a directory with services/*.yaml")
    told = {d.where for d in diagnostics}  # a mistake of its own is reported once
    by_kind, more = collected(_by_kind(sources))
    diagnostics += [*more, *check_spelling(sources)]
    every, by_kind = by_kind, {k: {n: s for n, s in of.items() if not s.partial} for k, of in by_kind.items()}
    on_inputs(inputs(root, by_kind))
    (whole, doubtful), more = collected(_catalog(every, broken, engine))
    kept = by_kind.get("Service", {})
    catalog = replace(whole, services={n: s for n, s in whole.services.items() if n in kept or n == DEVELOPER})
    more += check_conflicts(catalog, kept, sure=not broken or bool(by_kind.get("Policy")))
    catalog, of_images = collected(_with_images(catalog, by_kind, doubtful, engine))
    more = [d for d in (*more, *of_images) if d.where not in told]
    diagnostics = noted([*diagnostics, *more], [source.document for source in sources])
    refused = any(d.severity == "error" for d in diagnostics)
    # Of a refused tree only errors count: services that could not be read may be the ones that others need.
    checked = validate(catalog, by_kind, contained=not of_this_machine(engine))
    diagnostics += [d for d in checked if d.severity == "error" or not refused]
    if any(d.severity == "error" for d in diagnostics):
        partly = {f"{n}?": s for n, s in whole.services.items() if n not in catalog.services}
        unread = {**partly, **unread_secrets(root, edits or {}, broken)}
        return Loaded(None, _told(diagnostics), replace(catalog, services={**unread, **catalog.services}))
    diagnostics += _misnamed(sources)
    catalog = replace(catalog, fingerprint=fingerprint(catalog))
    return Loaded(catalog, _told(diagnostics), catalog, by_kind)


def _told(diagnostics: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Sorts by place. If there are too many, hints are left out, errors come before warnings, and the
    last line counts the rest."""
    entries = sorted(set(diagnostics))
    if len(entries) <= MOST_TOLD:
        return tuple(entries)
    entries = [d for d in entries if d.severity != HINT]
    if len(entries) <= MOST_TOLD:
        return tuple(entries)
    first = sorted(entries, key=lambda d: d.severity)[:MOST_TOLD]
    last = first[-1]
    more = f"{len(entries) - MOST_TOLD} more mistakes are not listed"
    return (*sorted(first), Diagnostic(last.where, more, "to fix these first", last.severity))


def _misnamed(sources: Iterable[Source]) -> Iterator[Diagnostic]:
    """Warns about files whose name differs from the name that they declare: either may be a typo."""
    for source in (s for s in sources if not s.several and s.path.stem not in stems(s.name)):
        message = f"the {source.kind} '{source.name}' is in a file called '{source.path.name}'"
        remedy = f"'{source.path.stem}', or rename the file"
        yield Diagnostic(source.where("metadata", "name"), message, remedy, "warning")


def load_or_raise(root: Path, engine: str = "", robot: str = "") -> Catalog:
    """Returns the Catalog of a tree, or raises Invalid with every diagnostic in its message."""
    return usable(root, load(root, engine=engine, robot=robot))


def usable(root: Path, loaded: Loaded) -> Catalog:
    """Returns what was loaded, or raises Invalid."""
    if loaded.catalog is None:
        raise unusable(root, loaded.errors)
    return loaded.catalog


def unusable(root: Path, errors: Sequence[Diagnostic]) -> Invalid:
    """The error for a tree that cannot be used."""
    why = "\n".join([counted(len(errors), "error"), *map(str, errors), ""])
    return Invalid(f"use the manifests in {root}", why, "to fix them, then `rorg validate`")


MOST_TOLD = 200
"""Maximum number of listed mistakes."""
UNTOLD = ("where", "origins", "fingerprint", "joins", "domain", "away")
"""Fields that are not declared by the tree, or that follow from others."""
LATER = (
    *("stand_ins", "cache_from", "inline", "networks", "volumes", "devices", "unplugged", "ros", "parts"),
    *("purge_shm", "connected", "notify", "managed", "may_report_graph", "machine", "machines"),
)
"""Fields that earlier versions did not have: a tree that does not use them keeps its fingerprint."""


FORMER = {"graph": "master"}
"""Field -> its name in earlier versions, which fingerprints keep."""


def fingerprint(catalog: Catalog) -> str:
    """A digest of everything that a tree declares, independent of where it is written."""

    def content(value: Any) -> dict[str, Any]:
        told = (f.name for f in fields(value) if f.name not in UNTOLD and not (f.name in LATER and _unsaid(value, f)))
        return {FORMER.get(name, name): getattr(value, name) for name in told}

    return hashlib.sha256(json.dumps(catalog, default=content, sort_keys=True).encode()).hexdigest()[:16]


def _unsaid(value: Any, field: Field[Any]) -> bool:
    """Whether the field has its default."""
    factory = field.default_factory
    default = field.default if factory is MISSING else factory()
    return bool(getattr(value, field.name) == default)


def _by_kind(sources: Iterable[Source]) -> Reading[dict[str, dict[str, Source]]]:
    """Groups sources by kind and name. Services and groups share one namespace, because a request names either."""
    by_kind: dict[str, dict[str, Source]] = {}
    for source in sources:
        rivals = [k for k in ("Service", "Group") if source.kind in ("Service", "Group")] or [source.kind]
        first = next((by_kind[k][source.name] for k in rivals if source.name in by_kind.get(k, {})), None)
        where = source.where("metadata", "name")
        if first:
            taken = f"is taken by a {first.kind} at {first.where('metadata', 'name')}"
            yield Diagnostic(where, f"the name '{source.name}' {taken}", "another name")
        elif source.name == DEVELOPER and (
            source.kind == "Group" or (source.kind == "Service" and source.spec.type != "meta")
        ):
            yield Diagnostic(where, "'developer' is the built-in meta-service", "another name")
        elif source.kind == "Policy" and by_kind.get("Policy"):
            other = next(iter(by_kind["Policy"].values()))
            yield Diagnostic(where, "a second Policy", f"to merge it into {other.document.file}")
        else:
            by_kind.setdefault(source.kind, {})[source.name] = source
    return by_kind


def _catalog(
    by_kind: Mapping[str, dict[str, Source]], broken: set[str], engine: str
) -> Reading[tuple[Catalog, set[str]]]:
    """Everything that could be read, and the names of services that may lack options because a profile or an Image of
    theirs has mistakes."""
    profiles, sources = {**built_in_profiles(), **by_kind.get("Profile", {})}, by_kind.get("Service", {})
    merged = yield from merge_profiles(profiles, broken)
    policy: Any = next((s.spec for s in by_kind.get("Policy", {}).values()), None)
    services: dict[str, Service] = {DEVELOPER: Service(DEVELOPER, meta=True, description="a person")}
    doubtful = set()
    for name, source in sources.items():
        yield from unknown_profiles(source, profiles, broken)
        profile = merged.of(source.spec.profile or ())
        if profile.partial or stem(source.spec.image or "") in broken:
            doubtful.add(name)
        services[name] = yield from _rendered(source, profile, policy, engine)
    machines = yield from machines_of(by_kind.get("Machine", {}))
    services = yield from belonging(services, sources, machines, broken)
    groups, requests = yield from _references(by_kind, services, broken)
    kept = {name: source for name, source in sources.items() if not source.partial}
    yield from (told_of_processes if of_this_machine(engine) else check_shared_memory)(services, kept)
    yield from check_container_names(services, kept)
    networks = yield from objects_of("network", by_kind.get("Network", {}), engine)
    volumes = yield from objects_of("volume", by_kind.get("Volume", {}), engine)
    yield from check_default(services, kept, {*networks, *broken})
    services = {n: joined(s, networks, volumes) for n, s in services.items()}
    yield from misspelt(services, kept, networks, volumes)
    policies = policy_of(policy) if policy else Policy()
    yield from check_crossings(services, kept)
    return Catalog(services, groups, {}, networks, volumes, requests, policies, machines), doubtful


def _references(
    by_kind: Mapping[str, dict[str, Source]], services: dict[str, Service], broken: set[str]
) -> Reading[tuple[dict[str, Group], tuple[Request, ...]]]:
    """Replaces the names in `services`; returns groups and standing requests. Reports unknown names and cycles."""
    sources = by_kind.get("Service", {})
    groups = yield from expand_groups(by_kind.get("Group", {}), services, broken)
    known = {*services, *groups}
    for name, source in sources.items():
        service = yield from join(source, services[name], services, groups, known | broken)
        services[name] = yield from resolve(source, service, services, groups, broken)
    yield from check_cycles(services, sources)
    yield from unknown_permitted(sources, known, broken)
    requests = yield from requests_of(by_kind.get("Request", {}), known, services, broken)
    return groups, requests


def _with_images(
    catalog: Catalog, by_kind: Mapping[str, dict[str, Source]], doubtful: Collection[str], engine: str
) -> Reading[Catalog]:
    sources = by_kind.get("Service", {})
    images = yield from images_of(by_kind.get("Image", {}), catalog.services)
    images = yield from secrets_of(catalog.services, images, sources, doubtful)
    yield from check_programs(catalog.services, sources, images, engine)
    return replace(catalog, images=images)


def _rendered(source: Source, profile: Merged, policy: Any, engine: str) -> Reading[Service]:
    try:
        return (yield from render(source, profile, policy, engine))
    except Exception as bug:
        yield unexpected(source.where("metadata", "name"), bug)
        return Service(source.name)
