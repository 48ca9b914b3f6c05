"""The corpus of projects to import (tests/cases/corpus, tests/cases/compose), and what becomes of each: `make corpus`.

A file of the corpus holds many projects, written in the manner of public robots:

    === NAME: compose --skip-unsupported -> refused    the words after `rorg import`, and the outcome if it is not valid
    --- PATH                                           a file; the first text of a Compose project is compose.yaml

The table shows the outcome, and whether `docker compose config`, if it is installed, reads the project as rorg does."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from common import ROOT
from compose_cases import CASES, SECTIONS, _section, arguments_of, cases, differences, environment_of, load_from, ours

from rorg.manifest.load import load
from rorg.tools.compose.load import load as read_project
from rorg.tools.importing.compose import from_compose
from rorg.tools.importing.manifests import Imported, write_tree
from rorg.tools.importing.roslaunch import from_roslaunch
from rorg.tools.importing.systemd import from_systemd
from rorg.tools.importing.systemd_unit import template_of

CORPUS = ROOT / "tests/cases/corpus"
HEAD = re.compile(r"=== ([\w-]+)(?:: (.*?))?(?: -> (refused|invalid))?")
NEVER_VALID = {"every_key": "refused", "extends_everything": "invalid"}
"""Cases of Compose with every key, or with values that no engine takes."""


@dataclass(frozen=True)
class Sample:
    """One project."""

    name: str
    words: tuple[str, ...]
    """After `rorg import`."""
    files: tuple[tuple[str, str], ...] = ()
    """(path, text)."""
    folder: Path | None = None
    """Its files, if they are in a directory."""
    expected: str = "valid"

    def write(self, folder: Path) -> None:
        """Writes its files into an empty directory."""
        if self.folder:
            shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        for path, text in self.files:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(text)


@dataclass(frozen=True)
class Outcome:
    """What becomes of a project."""

    how: str
    """valid; refused: nothing is written; or invalid: `rorg validate` refuses the manifests."""
    why: str = ""
    compose: str = "-"
    """Whether Compose reads it as rorg does: same, or the first difference."""
    services: int = 0
    """Of a valid tree, without the developer that every tree has."""
    warnings: int = 0


def samples() -> list[Sample]:
    """All projects, with those that Compose has been asked about."""
    found = [sample for path in sorted(CORPUS.glob("*.txt")) for sample in _of_text(path.read_text())]
    for name in cases():
        expected = NEVER_VALID.get(name, "valid")
        found.append(Sample(name, ("compose", *arguments_of(CASES / name)), (), CASES / name, expected))
    return found


def _of_text(text: str) -> Iterator[Sample]:
    for block in re.split(r"^(?==== )", text, flags=re.MULTILINE)[1:]:
        line, _, rest = block.partition("\n")
        head = HEAD.fullmatch(line)
        assert head, line
        first, *others = re.split(r"^--- (.+)\n", rest, flags=re.MULTILINE)
        files = [("compose.yaml", first)] if first.strip() else []
        files += zip(others[::2], others[1::2], strict=True)
        yield Sample(head[1], tuple(shlex.split(head[2] or "compose")), tuple(files), None, head[3] or "valid")


def text_of(path: Path) -> str | None:
    return path.read_text() if path.is_file() else None


def outcome(sample: Sample, folder: Path) -> Outcome:
    """Imports a project that is in `folder` into folder/manifests, and validates the result."""
    imported, compose = _imported(sample, folder)
    if imported.errors:
        return Outcome("refused", imported.errors[0].message, compose)
    write_tree(imported, folder / "manifests")
    loaded = load(folder / "manifests", engine="docker")
    if loaded.catalog is None or loaded.errors:
        return Outcome("invalid", loaded.errors[0].message, compose)
    return Outcome(
        "valid",
        "",
        compose,
        len(loaded.catalog.services) - 1,
        len([d for d in loaded.diagnostics if d.severity == "warning"]),
    )


def _imported(sample: Sample, folder: Path) -> tuple[Imported, str]:
    what, *words = sample.words
    skip = "--skip-unsupported" in words
    words = [word for word in words if word != "--skip-unsupported"]
    tree = folder / "manifests"
    if what == "systemd":
        paths = [folder / word for word in words]
        texts = {path: (path if path.exists() else template_of(path)).read_text() for path in paths}
        return from_systemd(texts, "", tree, skip), "-"
    if what == "roslaunch":
        arguments = dict(word.split(":=", 1) for word in words[1:])
        return from_roslaunch(folder / words[0], Path.read_text, arguments), "-"
    if sample.folder:
        loaded = load_from(folder)
    else:
        loaded = read_project([folder / w for w in words] or [folder], {"HOME": "/home/robot"})
    compare = _compared(sample, folder, loaded.project) if loaded.project else "-"
    if loaded.project is None:
        return Imported(diagnostics=loaded.diagnostics), compare
    return from_compose(loaded.project, tree, folder, text_of, skip), compare


def _compared(sample: Sample, folder: Path, project) -> str:
    """Whether `docker compose config` says the same; `-` if it is not installed."""
    if not COMPOSE:
        return "-"
    files = [w for w in sample.words[1:] if w.endswith((".yaml", ".yml"))] if not sample.folder else []
    named = [one for w in files for one in ("-f", w)] if files else arguments_of(folder)
    environment = {"PATH": "/usr/local/bin:/usr/bin:/bin", **environment_of(folder)}
    line = [*COMPOSE, *named, "config", "--format", "json"]
    done = subprocess.run(line, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        return f"refused: {done.stderr.strip()}"
    answer = json.loads(done.stdout)
    theirs = {kind: _section(answer.get(kind) or {}, dollars=True) for kind in SECTIONS} | {"name": answer["name"]}
    found = differences(ours(project), theirs)
    return found[0] if found else "same"


def _compose() -> list[str]:
    """The command line of Compose; empty if it is not installed."""
    for line in (["docker", "compose"], ["docker-compose"]):
        found = shutil.which(line[0])
        if found and subprocess.run([found, *line[1:], "version"], capture_output=True).returncode == 0:
            return [found, *line[1:]]
    return []


COMPOSE: list[str] = []


def main() -> int:
    """Prints the table. 1 if an outcome is not the expected one."""
    COMPOSE.extend(_compose())
    counted, wrong, services, warnings = Counter[str](), 0, 0, 0
    for sample in samples():
        with tempfile.TemporaryDirectory() as parent:
            folder = Path(parent) / sample.name
            folder.mkdir()
            sample.write(folder)
            found = outcome(sample, folder)
        services, warnings = services + found.services, warnings + found.warnings
        counted[found.how] += 1
        counted[f"Compose: {found.compose.partition(':')[0]}"] += 1
        wrong += found.how != sample.expected
        unexpected = "" if found.how == sample.expected else f" (expected: {sample.expected})"
        why = found.why.replace(parent, "")
        print(f"{sample.name:34} {sample.words[0]:10} {found.how:8}{unexpected} {found.compose[:40]:5} {why[:110]}")
    total = sum(counted[how] for how in ("valid", "refused", "invalid"))
    print(f"\n{total} projects: {', '.join(f'{n} {how}' for how, n in sorted(counted.items()))}; {wrong} unexpected")
    print(f"{warnings} warnings about {services} services: {warnings / services:.2f} a service")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
