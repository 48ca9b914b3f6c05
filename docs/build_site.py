"""Builds the documentation as a site with search: `make site`. The Markdown stays where it is and readable as it is.

MkDocs wants all pages below one folder. So the script copies every page of the repository, and every file that a page
links to, into a folder of their own, and builds from that. A link to a folder leads to a list of its files.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from urllib.parse import unquote

import yaml

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"\]\(([^)\s#]+)(#[^)\s]*)?\)")
FENCE = re.compile(r"(^```.*?^```$)", re.M | re.S)
CONFIGURATION = """
site_name: rorg
theme:
  name: material
  font: false  # readers fetch no fonts from elsewhere
  features: [navigation.indexes, navigation.top, search.highlight, content.code.copy]
  palette:
    - {media: "(prefers-color-scheme: light)", scheme: default, toggle: {icon: material/weather-night, name: Dark}}
    - {media: "(prefers-color-scheme: dark)", scheme: slate, toggle: {icon: material/weather-sunny, name: Light}}
plugins: [search]
use_directory_urls: false
validation: {anchors: warn, unrecognized_links: warn}
markdown_extensions:
  - tables
  - toc: {permalink: true, slugify: !!python/object/apply:pymdownx.slugs.slugify {kwds: {case: lower}}}
  - pymdownx.highlight
  - pymdownx.superfences:
      custom_fences: [{name: mermaid, class: mermaid, format: !!python/name:pymdownx.superfences.fence_code_format ""}]
"""


def pages() -> list[Path]:
    """Every page that git tracks, or does not ignore."""
    words = ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard", "*.md"]
    found = subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()
    return [Path(name) for name in found if not name.startswith("tests/")]


def copy(source: Path) -> None:
    """Copies all pages, and what they link to, into `source`."""
    for page in pages():
        place = source / page
        place.parent.mkdir(parents=True, exist_ok=True)
        text = (ROOT / page).read_text(encoding="utf-8")
        parts = FENCE.split(text)
        parts[::2] = [LINK.sub(lambda link, page=page: linked(source, page, link), part) for part in parts[::2]]
        place.write_text("".join(parts), encoding="utf-8")


def linked(source: Path, page: Path, link: re.Match[str]) -> str:
    """The link, with its target copied; a link to a folder leads to its list."""
    target = (ROOT / page.parent / unquote(link[1])).resolve()
    if ":" in link[1] or not target.is_relative_to(ROOT) or target.suffix == ".md":
        return link[0]
    place = source / target.relative_to(ROOT)
    if target.is_dir():
        write_list(target, place)
        return f"]({link[1].rstrip('/')}/README.md)"
    place.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(target, place)
    return link[0]


def write_list(folder: Path, place: Path) -> None:
    """A page with the files of a folder; they are copied. Its own README.md counts, if there is one."""
    place.mkdir(parents=True, exist_ok=True)
    if (folder / "README.md").exists():
        return
    files = sorted(f for f in folder.iterdir() if f.is_file())
    for file in files:
        shutil.copy(file, place)
    name = folder.relative_to(ROOT)
    (place / "README.md").write_text(
        f"# {name}\n\n" + "".join(f"- [{f.name}]({f.name})\n" for f in files), encoding="utf-8"
    )


def navigation(source: Path) -> list[object]:
    """The four kinds of pages, and those of the project."""

    def title(page: str) -> dict[str, str]:
        head = re.search(r"^# (.+)$", (source / page).read_text(encoding="utf-8"), re.M)
        return {head[1].replace("`", "") if head else page: page}

    def kind(folder: str) -> list[object]:
        return [title(str(p.relative_to(source))) for p in sorted((source / folder).glob("*.md")) if p.stem != "README"]

    return [
        {"rorg": "README.md"},
        {"Documentation": "docs/README.md"},
        title("docs/tutorial.md"),
        title("docs/tutorial-ros2.md"),
        title("docs/tutorial-machines.md"),
        {"How to": kind("docs/how-to")},
        {"Reference": kind("docs/reference")},
        {"Explanation": [*kind("docs/explanation"), title("docs/evaluation.md"), *kind("docs/evaluation")]},
        {"Clients": [title(str(p.relative_to(source))) for p in sorted((source / "clients").glob("*/README.md"))]},
        {"Project": [title(page) for page in ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")]},
    ]


def build(site: Path, more: str = "") -> int:
    """Builds the site into this folder; 0 if every link and anchor leads somewhere. `more`: text for the first page."""
    with tempfile.TemporaryDirectory(prefix="rorg-site-") as folder:
        source = Path(folder) / "pages"
        copy(source)
        with (source / "README.md").open("a", encoding="utf-8") as first:
            first.write(more)
        settings = {"docs_dir": str(source), "site_dir": str(site.resolve()), "nav": navigation(source)}
        file = Path(folder) / "mkdocs.yml"
        file.write_text(CONFIGURATION + yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
        words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file", str(file)]
        done = subprocess.run(
            words, check=False, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}
        )
        if done.returncode:
            print(
                "".join(line for line in done.stderr.splitlines(True) if not line.startswith("INFO")), file=sys.stderr
            )
        return done.returncode


if __name__ == "__main__":
    sys.exit(build(Path(sys.argv[1])))
