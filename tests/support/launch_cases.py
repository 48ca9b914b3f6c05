"""Launch files of ROS 2 and what becomes of them (tests/cases/launch), written in the manner of public robots.

    === NAME: the words after `rorg import roslaunch`
    --- PATH            a file of the project
    +++ KIND NAME       the manifest: its comments and its spec
    +++ launch/PATH     a launch file that the import generates
    +++ findings

`python tests/support/launch_cases.py` writes what becomes of them now; read the difference before you commit it."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common import CASES

from rorg.manifest.files import Reader
from rorg.manifest.yaml_text import plain, yaml_text
from rorg.tools.importing.manifests import Imported
from rorg.tools.importing.roslaunch import from_roslaunch

FOLDER = CASES / "launch"
ENVIRONMENT = {"ROBOT_MODEL": "burger", "HOME": "/home/robot"}


@dataclass(frozen=True)
class Case:
    """One launch file with its project."""

    name: str
    words: tuple[str, ...]
    source: str
    """The text of the case, up to what is expected."""
    files: tuple[tuple[str, str], ...]
    expected: str

    def imported(self, folder: Path) -> Imported:
        """Writes the project into an empty folder, and imports it."""
        for path, text in self.files:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(text)
        options = [word for word in self.words if word.startswith("--")]
        path, *given = [word for word in self.words if not word.startswith("--")]
        arguments = dict(word.split(":=", 1) for word in given)
        ros = next((int(word[-1]) for word in options if word.startswith("--ros=")), 0)
        return from_roslaunch(
            folder / path,
            Reader(folder),
            arguments,
            "lab/robot",
            ros=ros,
            environment=ENVIRONMENT,
            skip="--skip-unsupported" in options,
        )


def cases() -> list[Case]:
    """All cases."""
    return [case for path in sorted(FOLDER.glob("*.txt")) for case in _of_text(path.read_text())]


def _of_text(text: str) -> Iterator[Case]:
    for block in re.split(r"^(?==== )", text, flags=re.MULTILINE)[1:]:
        source, mark, rest = block.partition("\n+++ ")
        line, *parts = re.split(r"^--- (.+)\n", f"{source}\n" if mark else source, flags=re.MULTILINE)
        name, _, words = line.strip().removeprefix("=== ").partition(": ")
        files = tuple(zip(parts[::2], parts[1::2], strict=True))
        yield Case(name, tuple(words.split()), f"{source}\n" if mark else source, files, f"+++ {rest}" if mark else "")


def shown(imported: Imported, folder: Path) -> str:
    """What became of a launch file, with all findings. The folder is /project."""
    parts = []
    for made in imported.manifests if not imported.errors else ():
        comments = "".join(f"# {line}\n" for line in made.comments)
        parts.append(f"+++ {made.kind} {made.name}\n{comments}{yaml_text(_moved(plain(made.spec), folder))}")
    parts += [f"+++ {path}\n{text}" for path, text in imported.files.items() if not imported.errors]
    findings = "".join(f"{diagnostic}\n" for diagnostic in imported.diagnostics).replace(f"\n{folder}/", "\n")
    parts += [f"+++ findings\n{findings.removeprefix(f'{folder}/')}"] if findings else []
    return "".join(parts).replace(str(folder), "/project")


def _moved(value: Any, folder: Path) -> Any:
    """A value with the paths of the project as they are in /project, so that lines break in the same places."""
    if isinstance(value, dict):
        return {key: _moved(item, folder) for key, item in value.items()}
    if isinstance(value, list):
        return [_moved(item, folder) for item in value]
    return value.replace(str(folder), "/project") if isinstance(value, str) else value


def main() -> None:
    """Writes the results of now into the files of cases."""
    for path in sorted(FOLDER.glob("*.txt")):
        texts = []
        for case in _of_text(path.read_text()):
            with tempfile.TemporaryDirectory() as parent:
                folder = Path(parent).resolve()
                texts.append(case.source + shown(case.imported(folder), folder))
        path.write_text("".join(texts))


if __name__ == "__main__":
    main()
