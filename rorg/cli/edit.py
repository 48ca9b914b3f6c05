"""rorg edit"""

from __future__ import annotations

import os
import shlex
import sys
import textwrap
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any

import typer
from rorg_client import Client

from rorg.cli.context import Context
from rorg.cli.names import complete_services
from rorg.cli.options import Tree
from rorg.cli.output import disk_errors, echo, missing, note
from rorg.errors import Invalid, Refused
from rorg.model.image_names import stem

MARK = "# rorg: "
"""Begins the lines that are for the person who edits, and not part of the manifest."""
KINDS = {"svc": "Service"}
"""Short names, besides service, services and the like."""


def command(
    context: Tree,
    manifest: Annotated[
        str,
        typer.Argument(
            help="KIND/NAME, such as group/driving; NAME alone for a service.", autocompletion=complete_services
        ),
    ],
) -> None:
    """Edit a manifest in $VISUAL or $EDITOR. rorg checks it with the whole tree, writes it in one step and commits
    it.

    Example: rorg edit navigation
    """
    import shutil
    import tempfile

    kind, _, name = manifest.partition("/") if "/" in manifest else ("service", "", manifest)
    tree = manifests(context)
    chosen = _kind(kind)
    if name not in tree.names(chosen):
        raise missing(chosen.lower(), name, tree.names(chosen))
    editor, before = _editor(), tree.text(chosen, name)
    folder = Path(tempfile.mkdtemp(prefix="rorg-edit-"))
    path = folder / f"{stem(name)}.yaml"
    try:
        written = _until_right(editor, path, before, lambda text: tree.write(chosen, name, text))
    except Exception:
        note(f"nothing changed; your text is in {path}")
        raise
    shutil.rmtree(folder)
    echo(f"{chosen.lower()} {name} edited") if written else note("nothing changed")


def _kind(text: str) -> str:
    """A kind as in manifests. Raises Invalid."""
    from rorg.manifest.models import FOLDERS

    known = {**{k.lower(): k for k in FOLDERS.values()}, **FOLDERS, **KINDS}
    if text.lower() not in known:
        raise missing("kind", text, known)
    return known[text.lower()]


def _editor() -> list[str]:
    """The editor's command line. Raises Invalid if there is no terminal for one."""
    chosen = os.environ.get("VISUAL") or os.environ.get("EDITOR") or ""
    if not chosen.strip() and not sys.stdin.isatty():
        raise Invalid("open an editor", "there is no terminal", "a terminal, or a program as EDITOR")
    try:
        return shlex.split(chosen) or ["vi"]
    except ValueError as error:
        raise Invalid(f"open the editor {chosen}", str(error).lower(), "EDITOR=nano") from error


def _until_right(editor: list[str], path: Path, before: str, write: Any) -> bool:
    """Edits until the text is accepted; whether anything was changed. Raises Invalid for a mistake that was saved again
    unchanged."""
    text, mistake = before, None
    while True:
        shown = _with(mistake, text)
        _open(editor, path, shown)
        edited = path.read_text(encoding="utf-8", errors="replace")
        text = "".join(line for line in edited.splitlines(keepends=True) if not line.startswith(MARK))
        if text == before or not text.strip():
            return False
        if mistake is not None and edited == shown:
            raise mistake
        try:
            write(text)
            return True
        except Invalid as error:
            mistake = error


def _with(mistake: Exception | None, text: str) -> str:
    """The text, with its mistake on top."""
    if mistake is None:
        return text
    lines = [*textwrap.wrap(str(mistake), 100), "Fix it; or save it unchanged, or empty, to change nothing."]
    return "".join(f"{MARK}{line}\n" for line in (*lines, "Line numbers do not count these lines.")) + text


def _open(editor: list[str], path: Path, text: str) -> None:
    """Raises Invalid for an editor that fails."""
    import subprocess

    path.write_text(text, encoding="utf-8")
    with disk_errors(f"open the editor {editor[0]}", "EDITOR=nano"):
        code = subprocess.run([*editor, path]).returncode
    if code:
        raise Invalid(f"edit {path.stem}", f"the editor {editor[0]} ended with exit code {code}", "another EDITOR")


class Served:
    """The manifests of the running rorg."""

    def __init__(self, client: Client) -> None:
        from rorg.host.git import COMMIT_PATIENCE

        self.client, self._base = client, ""
        self._bases: dict[str, str] = {}
        client.timeout = 2 * COMMIT_PATIENCE  # a git hook may take some time

    def names(self, kind: str) -> Collection[str]:
        manifests = [m for m in self.client.manifests() if m["kind"] == kind]
        self._bases = {m["name"]: m["digest"] for m in manifests}
        return self._bases

    def text(self, kind: str, name: str) -> str:
        self._base = self._bases[name]
        return self.client.manifest(kind, name)

    def write(self, kind: str, name: str, text: str) -> None:
        import rorg_client

        try:
            self.client.put_manifest(kind, name, text, self._base, _message(kind, name))
        except rorg_client.Invalid as error:
            raise Invalid(error.what.removeprefix("cannot "), error.cause, error.remedy) from error


class Alone:
    """The manifests in a directory, by the same rules."""

    def __init__(self, context: Context) -> None:
        from rorg.api.manifest_texts import manifests_of

        self.state, self.root = context.state, context.root.resolve()
        if self.root.is_relative_to(self.state.git.resolve()):
            raise Refused(f"edit manifests in {self.root}", "they are those of a repository", "a commit there")
        if not self.root.is_dir():
            raise Invalid(f"edit manifests in {self.root}", "no such directory", "--manifests DIR")
        self.all = manifests_of(self.root)

    def names(self, kind: str) -> Collection[str]:
        return [n for k, n in self.all if k == kind]

    def text(self, kind: str, name: str) -> str:
        return self.all[kind, name].text.decode("utf-8", errors="replace")

    def write(self, kind: str, name: str, text: str) -> None:
        from rorg.api.manifest_change import ManifestChange, digest
        from rorg.api.manifest_texts import check_name, check_tree, file_with
        from rorg.host.person import caller

        kept = self.all[kind, name]
        path, before = kept.path, kept.content
        what = f"change the {kind} '{name}'"
        check_name(kind, name, text)
        whole = file_with(kept, kind, name, text) or ""
        check_tree(self.root, path, whole, engine="", what=what)
        person = caller(os.environ, os.getuid(), os.getgid()).name
        change = ManifestChange(
            str(path.relative_to(self.root)), digest(before), digest(whole.encode()), _message(kind, name), person, True
        )
        try:
            if path.read_bytes() != before:
                raise Refused(what, "it was changed meanwhile", "`rorg edit` again")
            change.carry_out(self.root, self.state.prepare().manifest_change, whole)
        except OSError as error:
            raise Refused(what, f"{error.filename}: {error.strerror}", "to check that file") from error


def _message(kind: str, name: str) -> str:
    """The message of the commit."""
    return f"edit {kind.lower()} {name}"


def manifests(context: Context) -> Served | Alone:
    """The manifests of the given directory, or of the running rorg, or of the directory that commands use by
    default."""
    client = None if context.directory else context.client()
    if client is None:
        context.here("edit its manifests")
    return Served(client) if client else Alone(context)
