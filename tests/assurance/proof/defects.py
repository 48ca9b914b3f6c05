"""Plants defects in a copy of rorg, and shows that the harness catches each: so every promise can fail.

Run by `make proof`. Arguments are names of defects; by default all.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from common import ASSURANCE, ROOT, SUPPORT

IGNORED = shutil.ignore_patterns("__pycache__", "*.pyc")
MOST = 60
"""Points within which a defect must be caught."""


@dataclass(frozen=True)
class Defect:
    """`edits` are (file, text, other text); `scenario` is where it shows."""

    name: str
    scenario: str
    edits: tuple[tuple[str, str, str], ...]


def defect(name: str, scenario: str, *edits: tuple[str, str, str]) -> Defect:
    return Defect(name, scenario, edits)


UNCHECKED = ("core/check.py", "        if unready:\n", "        if False and unready:\n")
BESIDE = ("core/check.py", "beside = not situation.engine.rolls", "beside = False")
OURS = """
def ours(container: Container) -> bool:
    import os

    from rorg.model.units import stamp

    return container.created_at >= stamp(os.stat(f"/proc/{os.getpid()}").st_ctime)


"""
DEFECTS = (
    defect(
        "contents without fsync",
        "request",
        ("store/files.py", "            if durable:\n                os.fsync(file.fileno())\n", ""),
    ),
    defect(
        "directory without fsync",
        "request",
        ("store/files.py", "    if durable:\n        sync", "    if False:\n        sync"),
    ),
    defect(
        "written in place",
        "replaced-request",
        ("store/files.py", "    temporary = path", "    return void(path.write_text(text))\n    temporary = path"),
        ("store/files.py", "def clear_leftovers", "def void(_: object) -> None: ...\n\n\ndef clear_leftovers"),
    ),
    defect(
        "acknowledged before the commit",
        "request",
        (
            "store/committer.py",
            "        try:\n            after = self.file.change",
            "        for _, told in batch:\n            told.set_result(self.changed(True))\n"
            "        try:\n            after = self.file.change",
        ),
        ("store/committer.py", "                future.set_result(generation)", "                pass"),
    ),
    defect(
        "a request that is sent again is another one",
        "replaced-request",
        ("store/requests_document.py", "if all(r.key != request.key for r in self.requests):", "if True:"),
    ),
    defect(
        "starts before needs are ready",
        "first-apply",
        ("core/gates.py", "        reason = view.unready(need)\n        if not", '        reason = ""\n        if not'),
        UNCHECKED,
    ),
    defect(
        "the old container goes before the new one is proven",
        "replacement",
        (
            "core/reconcile.py",
            "self.clear([p for p in stale if p[0] is not swap.old], True)",
            "self.clear(stale, True)",
        ),
        ("core/reconcile.py", "        if swap.old:\n            steps += self.make_room(swap.old)\n", ""),
        ("core/reconcile.py", "if swap.old and swap.old.alive and not self.rolls_over():", "if False:"),
    ),
    defect(
        "the new container starts beside the old one",
        "replacement",
        ("core/reconcile.py", "if swap.old and swap.old.alive and not self.rolls_over():", "if False:"),
        BESIDE,
    ),
    defect(
        "containers of an earlier rorg are not adopted",
        "first-apply",
        (
            "core/reconcile.py",
            "if not d.recreate and c.id not in self.moved), None)",
            "if not d.recreate and ours(c)), None)",
        ),
        ("core/reconcile.py", "class _Reconciled:\n", f"{OURS}class _Reconciled:\n"),
    ),
    defect(
        "containers without a service are taken for one",
        "removal",
        ("core/observed.py", "        if container.service:\n", "        if True:\n"),
        ("core/observed.py", "setdefault(container.service, [])", 'setdefault(container.service or "base", [])'),
    ),
    defect(
        "exclusive resources are not waited for",
        "preemption",
        ("core/room.py", "    for resource in service.exclusive:\n", "    for resource in ():\n"),
    ),
    defect(
        "the note of a change goes before its commit",
        "manifest-put",
        (
            "api/manifest_change.py",
            "        commit(root, path, self.author, self.message)\n        note.unlink()\n",
            "        note.unlink()\n        commit(root, path, self.author, self.message)\n",
        ),
    ),
    defect(
        "a deleted manifest without fsync",
        "manifest-delete",
        ("api/manifest_change.py", "remove_durably(root / self.file)", "(root / self.file).unlink()"),
    ),
    defect(
        "an interrupted change is not finished",
        "manifest-put",
        ("api/server.py", "        self.app.state.manifests.recover()\n", ""),
    ),
    defect(
        "a restart forgets that a change failed",
        "failed-update",
        ("daemon/saved_memory.py", 'quarantined=_texts(known.get("quarantined"))', "quarantined={}"),
    ),
    defect(
        "a robot that is taken down is forgotten",
        "down",
        ("store/requests_parser.py", "if document.down else", "if document.down_since else"),
    ),
    defect(
        "files on their way stay",
        "request",
        (
            "store/files.py",
            "            path.unlink(missing_ok=True)\n\n\ndef regular",
            "            pass\n\n\ndef regular",
        ),
    ),
    defect(
        "what was declared before is not written down",
        "emptied-tree",
        ("daemon/write_ahead.py", "write_kept(self.state.path, kept)", "pass"),
    ),
    defect(
        "exported files are written in place",
        "export",
        (
            "cli/export.py",
            'write_atomic(path, text, mode=0o600 if path.suffix == ".env" else 0o644 & ~mask)',
            "path.write_text(text)",
        ),
    ),
    defect(
        "an import without fsync",
        "import",
        ("tools/importing/manifests.py", "            sync(path)\n", "            pass\n"),
    ),
    defect(
        "an image is built although it is there",
        "image-build",
        ("images/supply.py", "present = reference in self.there", "present = False"),
    ),
)


def planted(one: Defect, folder: Path) -> Path:
    """A copy of rorg with the defect."""
    for name in ("rorg", "clients/python"):
        shutil.copytree(ROOT / name, folder / name, symlinks=True, ignore=IGNORED)
    for name, text, other in one.edits:
        path = folder / "rorg" / name
        content = path.read_text()
        assert content.count(text) == 1, f"{one.name}: {content.count(text)} times in {name}: {text!r}"
        path.write_text(content.replace(text, other))
    return folder


def caught(one: Defect) -> str:
    """The first violation, and after how many points; empty if there is none."""
    folder = Path(tempfile.mkdtemp(prefix="rorg-defect."))
    try:
        copy = planted(one, folder)
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, (copy, copy / "clients/python", ASSURANCE, SUPPORT))),
            "PYTHONDONTWRITEBYTECODE": "1",
            "RORG_PROOF_MOST": str(MOST),
            "RORG_PROOF_STOP": "1",
        }
        command = [sys.executable, "-m", "proof.play", one.scenario]
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    if done.returncode != 1:
        return ""
    broken = re.search(r"^(?:\S+: broken: \w+ )?(.*?([a-z_]+: .*|not within .*))$", done.stdout, re.MULTILINE)
    points = re.search(r"(\d+) points \(", done.stdout)
    return f"{points[1] if points else 'no'} points: {broken[1][:160] if broken else done.stdout[-300:]}"


def main(names: list[str]) -> int:
    missed = 0
    for one in DEFECTS:
        if names and one.name not in names:
            continue
        began = time.monotonic()
        found = caught(one)
        missed += not found
        print(f"{one.name}: {found or 'NOT CAUGHT'} ({time.monotonic() - began:.0f} s)", flush=True)
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
