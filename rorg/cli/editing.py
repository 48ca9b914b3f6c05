"""The manifests that `rorg edit` changes: those of the running rorg, or, where none serves, of a directory."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rorg_client import Client

    from rorg.cli.context import Context


class Manifests(Protocol):
    """Of one tree."""

    def names(self, kind: str) -> Collection[str]:
        """All of a kind."""

    def text(self, kind: str, name: str) -> str:
        """One manifest, from which the edit begins."""

    def write(self, kind: str, name: str, text: str) -> None:
        """Writes it, if the tree is valid with it and nobody has changed it meanwhile; committed where the tree is in
        git. Raises Invalid for mistakes, others for all else."""


class Served:
    """By the running rorg."""

    def __init__(self, client: Client) -> None:
        from rorg.host.git import COMMIT_PATIENCE

        self.client, self._base = client, ""
        self._bases: dict[str, str] = {}
        client.timeout = 2 * COMMIT_PATIENCE  # a hook of git may take its time

    def names(self, kind: str) -> Collection[str]:
        found = [m for m in self.client.manifests() if m["kind"] == kind]
        self._bases = {m["name"]: m["digest"] for m in found}
        return self._bases

    def text(self, kind: str, name: str) -> str:
        self._base = self._bases[name]
        return self.client.manifest(kind, name)

    def write(self, kind: str, name: str, text: str) -> None:
        import rorg_client

        from rorg.errors import Invalid

        try:
            self.client.put_manifest(kind, name, text, self._base, _message(kind, name))
        except rorg_client.Invalid as error:
            raise Invalid(error.what.removeprefix("cannot "), error.cause, error.remedy) from error


class Alone:
    """In a directory, by the same rules."""

    def __init__(self, context: Context) -> None:
        from rorg.api.manifest_texts import manifests_of
        from rorg.errors import Invalid, Refused

        self.state, self.root = context.state, context.root.resolve()
        if self.root.is_relative_to(self.state.git.resolve()):
            raise Refused(f"edit manifests in {self.root}", "they are those of a repository", "a commit there")
        if not self.root.is_dir():
            raise Invalid(f"edit manifests in {self.root}", "no such directory", "--manifests DIR")
        self.all = manifests_of(self.root)

    def names(self, kind: str) -> Collection[str]:
        return [n for k, n in self.all if k == kind]

    def text(self, kind: str, name: str) -> str:
        return self.all[kind, name][1].decode("utf-8", errors="replace")

    def write(self, kind: str, name: str, text: str) -> None:
        import os

        from rorg.api.manifest_change import ManifestChange, digest
        from rorg.api.manifest_texts import check_name, check_tree
        from rorg.api.permissions import Caller
        from rorg.errors import Refused

        path, before = self.all[kind, name]
        what = f"change the {kind} '{name}'"
        check_name(kind, name, text)
        check_tree(self.root, path, text, "", what)
        person = Caller("developer", uid=os.getuid()).author
        change = ManifestChange(
            str(path.relative_to(self.root)), digest(before), digest(text.encode()), _message(kind, name), person, True
        )
        try:
            if path.read_bytes() != before:
                raise Refused(what, "it was changed meanwhile", "`rorg edit` again")
            change.carry_out(self.root, self.state.prepare().manifest_change, text)
        except OSError as error:
            raise Refused(what, f"{error.filename}: {error.strerror}", "fixing what is there") from error


def _message(kind: str, name: str) -> str:
    """Of the commit."""
    return f"edit {kind.lower()} {name}"


def manifests(context: Context) -> Manifests:
    """Those of a directory that was named, else of the running rorg, else of the directory that commands look at."""
    client = None if context.directory else context.client()
    if client is None:
        context.here("edit its manifests")
    return Served(client) if client else Alone(context)
