"""Files of the tree that a service mounts. Its tasks may run on any node, so the files go with it: as a Swarm secret if
others may not read the file, otherwise as a config. Both are named by the digest of their content, because their
content can never change."""

from __future__ import annotations

import base64
import hashlib
import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rorg.core.observed import LABEL_OWNER
from rorg.engines.docker.body import Body
from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import Refused
from rorg.errors import EngineError
from rorg.regular_file import read_regular

MOST_FILES = 100
"""Files of one service."""
MOST_BYTES = 500 << 10
"""Bytes of one file (moby: maxConfigSize, maxSecretSize)."""
LABEL_FILE = "rorg.io/file"
"""The label of secrets and configs that hold a file."""
Mounts = Sequence[tuple[str, str]]
"""(path in the tree, path in the container)."""


@dataclass(frozen=True, slots=True)
class File:
    """A file as the tasks of a service get it."""

    target: str
    data: bytes
    mode: int

    @property
    def kind(self) -> str:
        return "configs" if self.mode & stat.S_IROTH else "secrets"

    def name(self, owner: str) -> str:
        digest = hashlib.sha256(f"{owner}\0{self.kind}\0".encode() + self.data).hexdigest()
        return f"rorg.{digest[:40]}"


def files_of(mounts: Mounts) -> list[File]:
    """Read all files. Raises EngineError if there are too many, or one is too large."""
    files: list[File] = []
    for source, target in mounts:
        for path, inside in _walk(source, target):
            try:
                data = read_regular(Path(path), MOST_BYTES)
                mode = stat.S_IMODE(os.stat(path).st_mode)
            except OSError as error:
                why = f"{path}: {error.strerror}"
                raise EngineError(
                    "send its files to the Swarm", why, f"files of at most {MOST_BYTES >> 10} KiB"
                ) from error
            files.append(File(inside, data, mode & ~0o222))
            if len(files) > MOST_FILES:
                why = f"{source} has more than {MOST_FILES} files"
                raise EngineError("send its files to the Swarm", why, "to put them into the image")
    return files


def _walk(source: str, target: str) -> Iterator[tuple[str, str]]:
    """(path, path in the container) of each file, without hidden ones."""
    if not os.path.isdir(source):
        yield source, target
        return
    for folder, names, files in os.walk(source):
        names[:] = sorted(name for name in names if not name.startswith("."))
        for name in sorted(files):
            if not name.startswith("."):
                path = os.path.join(folder, name)
                yield path, os.path.join(target, os.path.relpath(path, source))


def references(client: Client, owner: str, files: Sequence[File]) -> Mapping[str, list[Body]]:
    """Make what is missing, and return the parts `Secrets` and `Configs` of a task's container."""
    made: dict[str, list[Body]] = {"Secrets": [], "Configs": []}
    for file in files:
        one, name = file.kind.removesuffix("s").capitalize(), file.name(owner)
        made[f"{one}s"].append(
            {
                "File": {"Name": file.target, "UID": "0", "GID": "0", "Mode": file.mode},
                f"{one}ID": _id(client, owner, file, name),
                f"{one}Name": name,
            }
        )
    return made


def _id(client: Client, owner: str, file: File, name: str) -> str:
    for row in client.get(f"/{file.kind}", filters={"name": [name]}):
        if row["Spec"]["Name"] == name:
            return str(row["ID"])
    labels = {LABEL_OWNER: owner, LABEL_FILE: file.target}
    body = {"Name": name, "Labels": labels, "Data": base64.b64encode(file.data).decode()}
    return str(client.post(f"/{file.kind}/create", body)["ID"])


def remove_unused(client: Client, owner: str, specs: Sequence[Mapping[str, Any]]) -> None:
    """Remove files that no service uses any more. The Swarm refuses to remove one that is in use."""
    for kind in ("Secret", "Config"):
        used = {
            one[f"{kind}ID"] for spec in specs for one in spec["TaskTemplate"]["ContainerSpec"].get(f"{kind}s") or ()
        }
        filters = {"label": [f"{LABEL_OWNER}={owner}"]}
        for row in client.get(f"/{kind.lower()}s", filters=filters):
            if row["ID"] not in used and LABEL_FILE in (row["Spec"].get("Labels") or {}):
                try:
                    client.delete(f"/{kind.lower()}s/{row['ID']}")
                except Refused:
                    continue  # in use by a task that is ending, or gone already
