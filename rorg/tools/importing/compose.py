"""Imports a Compose project as a robot.

Its services get a common profile that adds nothing, so that rorg creates the same containers as Compose does."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rorg.manifest.yaml_text import Noted
from rorg.tools.compose.project import Project
from rorg.tools.importing.compose_images import images
from rorg.tools.importing.compose_keys import NETWORK, VOLUME, Row
from rorg.tools.importing.compose_options import OF_THE_ENGINE
from rorg.tools.importing.compose_services import fixed_variables, services
from rorg.tools.importing.compose_work import SOUND, Work, nonempty
from rorg.tools.importing.manifests import Imported, Made

VALID = "letters, digits, - _ and dots, starting with a letter or digit"
NAMED = "as Compose calls it"


def networks(work: Work) -> list[Made]:
    """Networks that a service is in, without those that the engine always has."""
    used = {n for said in work.project.services.values() for n in said.get("networks") or ()}
    engines = {n for n in used if work.known("networks", n) in OF_THE_ENGINE}
    names = _used(work, "networks", used, "no service is in the network")
    return [_object(work, "Network", "networks", name, NETWORK) for name in names if name not in engines]


def volumes(work: Work) -> list[Made]:
    """Volumes that a service mounts."""
    mounts = [m for said in work.project.services.values() for m in said.get("volumes") or ()]
    used = {m.get("source") or "" for m in mounts if m["type"] == "volume"}
    names = _used(work, "volumes", used, "no service mounts the volume")
    return [_object(work, "Volume", "volumes", name, VOLUME) for name in names]


def _used(work: Work, section: str, used: Collection[str], otherwise: str) -> list[str]:
    """The names of a section that are used, with a note on each of the others."""
    names: Mapping[str, Any] = getattr(work.project, section)
    for name in names.keys() - used:
        work.note(f"{otherwise} {name}, so it gets no manifest", section, name)
    return [name for name in names if name in used]


def _object(work: Work, kind: str, section: str, name: str, table: Mapping[str, Row]) -> Made:
    said: Mapping[str, Any] = getattr(work.project, section)[name]
    before = len(work.found)
    work.check(table, said, section, name, shown=f"{section}.{name}.")
    called, known = work.called(section, name), work.known(section, name)
    comments = [f"From {work.origin(section, name)}, {kind.lower()} {name}.", *work.told(before)]
    if said.get("external"):
        return Made(kind, called, {**({"name": known} if known != called else {}), "external": True}, tuple(comments))
    if kind == "Volume":
        comments.append(
            f"If Compose has already created {known}, write `external: true` and nothing else but the name."
        )
    spec: dict[str, Any] = {"name": Noted(known, NAMED)} if known != called else {}
    carried = (key for key, row in table.items() if row.how == "carried" and key not in ("name", "external", "ipam"))
    spec |= nonempty({key: said.get(key) for key in carried})
    return Made(kind, called, spec | nonempty({"ipam": _ipam(said.get("ipam") or {})}), tuple(comments))


def _ipam(said: Mapping[str, Any]) -> dict[str, Any]:
    """Without empty values: `ipam: {}` means nothing."""
    pools = list(filter(None, map(nonempty, said.get("config") or ())))
    return nonempty({"driver": said.get("driver"), "config": pools, "options": said.get("options")})


def _refuse_services(work: Work) -> None:
    """Refuses services that rorg cannot have at all. If they are skipped, nothing needs them any more."""
    refused = set()
    for name, said in work.project.services.items():
        if not SOUND.fullmatch(name):
            message, remedy = f"'{name}' is not a valid name of a service in rorg", VALID
        elif name == "developer":
            message, remedy = "'developer' names a person in rorg, not a service", "another name"
        elif not (said.get("build") or said.get("image")):
            message, remedy = f"{name} has neither image nor build", "image: NAME"
        else:
            continue
        refused.add(name)
        work.refuse(message, "services", name, remedy=remedy)
    if work.skip and refused:
        kept = {n: _without(said, refused) for n, said in work.project.services.items() if n not in refused}
        work.project = replace(work.project, services=kept, enabled=work.project.enabled - refused)


def _without(said: Mapping[str, Any], refused: set[str]) -> dict[str, Any]:
    """A service that does not need these others."""
    needs = {name: how for name, how in (said.get("depends_on") or {}).items() if name not in refused}
    links = [link for link in said.get("links") or () if link.partition(":")[0] not in refused]
    return {**said, "depends_on": needs, "links": links}


def _note_models(work: Work) -> None:
    for name in work.project.models:
        message = f"models.{name} is not carried over: rorg does not run models"
        work.note(message, "models", name, remedy="a service that runs the model")


def groups(work: Work) -> list[Made]:
    """One group for each profile, and one for each service with several copies."""
    services = work.project.services
    manifests = []
    for name in services:
        if (copies := work.copies(name)) > 1:
            members = [f"{name}-{n}" for n in range(1, copies + 1)]
            comment = f"From {work.origin('services', name)}: the {copies} copies of {name}."
            manifests.append(Made("Group", name, {"services": members}, (comment,)))
    profiles: dict[str, list[str]] = {}
    for name in services:
        for profile in work.project.profiles.get(name, ()):
            profiles.setdefault(profile, []).append(name)
    for profile, members in profiles.items():
        group = f"profile-{profile}" if profile in services or not SOUND.fullmatch(profile) else profile
        place = ("services", members[0], "profiles")
        if group != profile:
            work.note(f"the profile {profile} becomes the group {group}, because a service has its name", *place)
        comment = f"From {work.origin(*place)}: the profile {profile}. `rorg request {group}` starts it."
        manifests.append(Made("Group", group, {"services": members}, (comment,)))
    return manifests


def requests(work: Work) -> list[Made]:
    """A standing request for everything that `docker compose up` runs."""
    names = [n for n in work.project.services if n in work.project.enabled and work.copies(n) > 0]
    if not names:
        message = "every service has a profile, so nothing runs without a request"
        work.note(message, "services", remedy="`rorg request GROUP`, or --profile")
        return []
    comments = (
        "What `docker compose up` runs. A service that is not in this list runs only while something requests it,",
        "or while a running service needs it.",
    )
    spec = {"services": names, "reason": f"docker compose up of {work.project.name}"}
    return [Made("Request", "compose", spec, comments)]


COMMON = Made(
    "Profile",
    "common",
    {},
    (
        "Adds nothing to a service, like Compose. Without this file, rorg gives every container network_mode: host,",
        "an init process, no-new-privileges and a log rotation; see `rorg explain`.",
    ),
)


def from_compose(
    project: Project,
    tree: Path,
    top: Path,
    read: Callable[[Path], str | None],
    skip: bool = False,
) -> Imported:
    """The manifests of a project, with a finding for everything that cannot be carried over.

    `tree`: where the manifests will be; `top`: paths below it are written relative to them (both absolute).
    `read`: the text of a file, None if it does not exist. `skip`: leave out what cannot be carried over."""
    work = Work(project, tree, top, read, skip)
    _refuse_services(work)
    _note_models(work)
    built, used = images(work)
    made = [COMMON, *services(work, used), *built, *networks(work), *volumes(work), *groups(work), *requests(work)]
    diagnostics = [*work.found, *fixed_variables(work)]
    return Imported(tuple(made), dict(work.files), frozenset(work.private), tuple(sorted(dict.fromkeys(diagnostics))))
