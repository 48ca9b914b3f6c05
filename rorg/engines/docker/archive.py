"""Copies files into and out of a container by the engine's archives. An archive from a container is not trusted:
nothing is written outside of the named place."""

from __future__ import annotations

import base64
import json
import posixpath
import tarfile
import tempfile
from copy import copy
from pathlib import Path
from typing import Any, NamedTuple

from rorg.engines.docker.client import API_TIMEOUT, Client
from rorg.engines.docker.errors import Refused
from rorg.engines.places import place_of, refused
from rorg.engines.unpack import unpack as unpack_members
from rorg.errors import Invalid

DIRECTORY, LINK = 1 << 31, 1 << 27
"""Bits of a mode, as in Go."""


class Inside(NamedTuple):
    """A path in a container, links followed."""

    path: str
    directory: bool


def fetch(client: Client, container: str, path: str, place: Path) -> None:
    """See Access.fetch. Raises the client's errors, and Invalid."""
    entry = _look(client, container, path)
    if entry is None:
        raise Invalid(f"copy {path}", "no such file in the container", "a path as the service sees it")
    target = place_of(path, place, place.is_dir(), entry.directory)
    url = f"/containers/{container}/archive"
    with (
        refused(f"copy {path} to {target}"),
        client.stream("GET", url, None, API_TIMEOUT, path=entry.path) as stream,
        tarfile.open(fileobj=stream.answer, mode="r|") as archive,
    ):
        unpack(archive, target, entry.directory)


def unpack(archive: tarfile.TarFile, target: Path, directory: bool) -> None:
    """Unpack the first entry as `target`, and all others below it. Raises TarError for entries that lead out of it, and
    OSError."""
    folder, first = (target, ".") if directory else (Path(target.resolve().parent), target.resolve().name)
    root: list[str] = []

    def placed(name: str) -> str:
        root[:] = root or [name]
        inner = "." if name == root[0] else name.removeprefix(f"{root[0]}/")
        return first if inner == "." else inner

    def renamed(member: tarfile.TarInfo) -> tarfile.TarInfo:
        member = copy(member)
        member.name = placed(member.name.rstrip("/"))
        member.linkname = placed(member.linkname) if member.islnk() else member.linkname
        return member

    if directory:
        folder.mkdir(exist_ok=True)
    unpack_members(archive, folder, map(renamed, archive))


def put(client: Client, container: str, source: Path, path: str) -> None:
    """See Access.put. Raises the client's errors, and Invalid."""
    entry, directory = _look(client, container, path), source.is_dir()
    if entry and directory and not entry.directory:
        raise Invalid(f"copy {source} to {path}", "it is a file in the container, and a directory here", "another path")
    whole = _absolute(client, container, path)
    target = place_of(str(source), Path(entry.path if entry else whole), bool(entry and entry.directory), directory)
    with refused(f"copy {source} to {path}"), tempfile.TemporaryFile() as file:
        with tarfile.open(fileobj=file, mode="w") as archive:
            archive.add(source.resolve(), arcname=target.name or ".", filter=_of_root)
        file.seek(0)
        try:
            client.put(f"/containers/{container}/archive", file, path=str(target.parent), noOverwriteDirNonDir=True)
        except Refused as no:
            if no.status != 404:
                raise
            raise Invalid(f"copy {source} to {path}", f"no directory {target.parent} in the container") from no


def _of_root(member: tarfile.TarInfo) -> tarfile.TarInfo:
    """Users of this machine have no meaning inside."""
    member.uid, member.gid, member.uname, member.gname = 0, 0, "", ""
    return member


def _absolute(client: Client, container: str, path: str) -> str:
    """An absolute path inside; relative ones begin at the working directory."""
    if path.startswith("/"):
        return path
    folder = client.get(f"/containers/{container}/json")["Config"].get("WorkingDir") or "/"
    return posixpath.join(folder, path)


def _look(client: Client, container: str, path: str) -> Inside | None:
    """The entry at a path, with a link followed; None if there is none."""
    place = posixpath.normpath(_absolute(client, container, path))
    facts = _stat(client, container, place)
    if facts and facts["mode"] & LINK and facts["linkTarget"]:
        place = str(facts["linkTarget"])
        facts = _stat(client, container, place)
    return Inside(place, bool(facts["mode"] & DIRECTORY)) if facts else None


def _stat(client: Client, container: str, path: str) -> dict[str, Any] | None:
    try:
        told = client.header(f"/containers/{container}/archive", "X-Docker-Container-Path-Stat", path=path)
        return dict(json.loads(base64.b64decode(told)))
    except Refused as no:
        if no.status == 404:
            return None
        raise
