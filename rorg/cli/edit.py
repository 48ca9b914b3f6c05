"""rorg edit"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from rorg.cli.options import (
    SERVICES,
    Argument,
    EngineName,
    ManifestsDirectory,
    StateDirectory,
)

MARK = "# rorg: "
"""How lines begin that are for whoever edits, and not of the manifest."""
KINDS = {"svc": "Service"}
"""Short names, beside service, services and the like."""


def command(
    manifest: Annotated[
        str, Argument("KIND/NAME, such as group/driving; NAME alone for a service.", completes=SERVICES)
    ],
    directory: ManifestsDirectory = None,
    state_dir: StateDirectory = None,
    engine: EngineName = None,
) -> None:
    """Edit a manifest in $VISUAL or $EDITOR. rorg checks it with the whole tree, writes it in one step and commits
    it.

    Example: rorg edit navigation
    """
    import shutil
    import tempfile

    from rorg.cli.context import Context
    from rorg.cli.editing import manifests
    from rorg.cli.output import echo, missing, note
    from rorg.model.image_names import stem

    kind, _, name = manifest.partition("/") if "/" in manifest else ("service", "", manifest)
    tree = manifests(Context(state_dir, engine, Path(directory) if directory else None, local=True))
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
    """A kind, as manifests have it. Raises Invalid."""
    from rorg.cli.output import missing
    from rorg.manifest.models import FOLDERS

    known = {**{k.lower(): k for k in FOLDERS.values()}, **FOLDERS, **KINDS}
    if text.lower() not in known:
        raise missing("kind", text, known)
    return known[text.lower()]


def _editor() -> list[str]:
    """The command. Raises Invalid where nobody is there to use one."""
    import os
    import shlex
    import sys

    from rorg.errors import Invalid

    chosen = os.environ.get("VISUAL") or os.environ.get("EDITOR") or ""
    if not chosen.strip() and not sys.stdin.isatty():
        raise Invalid("open an editor", "there is no terminal", "it in one, or a program as EDITOR")
    try:
        return shlex.split(chosen) or ["vi"]
    except ValueError as error:
        raise Invalid(f"open the editor {chosen}", str(error).lower(), "EDITOR=nano") from error


def _until_right(editor: list[str], path: Path, before: str, write: Any) -> bool:
    """Edits until it is accepted; whether anything was changed. Raises Invalid for a mistake that was left as it is."""
    from rorg.errors import Invalid

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
    """The text with what is wrong with it on top."""
    import textwrap

    if mistake is None:
        return text
    lines = [*textwrap.wrap(str(mistake), 100), "Mend it; or save it as it is, or empty, and nothing changes."]
    return "".join(f"{MARK}{line}\n" for line in (*lines, "Line numbers do not count these lines.")) + text


def _open(editor: list[str], path: Path, text: str) -> None:
    """Raises Invalid for an editor that fails."""
    import subprocess

    from rorg.errors import Invalid

    path.write_text(text, encoding="utf-8")
    try:
        code = subprocess.run([*editor, path]).returncode
    except OSError as error:
        raise Invalid(f"open the editor {editor[0]}", error.strerror or str(error), "EDITOR=nano") from error
    if code:
        raise Invalid(f"edit {path.stem}", f"the editor {editor[0]} ended with exit code {code}", "another EDITOR")
