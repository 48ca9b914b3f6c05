"""rorg init"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from rorg.cli.options import Argument
from rorg.cli.output import disk_errors, note
from rorg.errors import Refused

TEMPLATE = Path(__file__).parent / "first_robot"
WRITTEN = ("services", "schemas", "README.md", ".gitignore", ".vscode")
HIDDEN = ("gitignore", "vscode")
NEXT = """{name} is a robot of three services{git}. Next:
{cd}  rorg validate                     # every mistake, with file:line:column
  rorg build                        # on Docker, once: fetch the images
  rorg run                          # the loop; without Docker: rorg run --engine process
  rorg request navigation --wait    # in another terminal: it starts, with all that it needs
  rorg down                         # stop and remove everything; the files stay"""


def command(
    directory: Annotated[Path, Argument("Directory to write to; created if missing.", show_default=False)] = Path("."),
) -> None:
    """Write a first robot, ready to run: three services with comments, schemas for editors, in git.

    Example: rorg init robot
    """
    from rorg.manifest.schema import write

    files = {_place(path): path for path in sorted(TEMPLATE.rglob("*")) if path.is_file() and path.suffix != ".pyc"}
    there = [str(place) for place in (*files, Path("schemas")) if (directory / place).exists()]
    if there:
        raise Refused(f"write a robot into {directory}", f"{', '.join(there)} already exists", "another directory")
    with disk_errors(f"write a robot into {directory}", "another one"):
        for place, path in files.items():
            (directory / place).parent.mkdir(parents=True, exist_ok=True)
            (directory / place).write_bytes(path.read_bytes())
        write(directory / "schemas", check=False)
    change = "" if directory == Path(".") else f"  cd {directory}\n"
    note(NEXT.format(name=directory.resolve().name, git=_committed(directory), cd=change))


def _place(path: Path) -> Path:
    """The place of a file of the template, where hidden names have no dot so that no tool obeys them here."""
    place = path.relative_to(TEMPLATE)
    return Path(f".{place}") if place.parts[0] in HIDDEN else place


def _committed(directory: Path) -> str:
    """Commits it to git with the user's identity; a text about the result."""
    import subprocess

    def git(*words: str) -> bool:
        return subprocess.run(["git", "-C", directory, *words], capture_output=True).returncode == 0

    try:
        if not git("rev-parse", "--git-dir") and not git("init", "--quiet"):
            return ""
        git("add", "--", *WRITTEN)
        done = git("commit", "--quiet", "--message", "A first robot", "--", *WRITTEN)
        return ", in git" if done else "; commit it: `git commit -am 'A first robot'`"
    except OSError:  # there is no git here; rorg works without it
        return ""
