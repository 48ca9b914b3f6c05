"""Writes figures as SVG, PNG or HTML. matplotlib is an extra of the installation (`rorg[plots]`), and slow to load, so
it is imported only to draw."""

from __future__ import annotations

import io
import logging
import sys
from collections.abc import Callable
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from rorg.errors import Invalid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".svg", ".png", ".html")
REMEDY = f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
PAGE = (
    '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    "<style>body {{ margin: 1rem; background: #fff }} svg {{ max-width: 100%; height: auto }}</style></head>\n"
    "<body>{svg}</body></html>\n"
)


def install() -> str:
    """The command that installs what plots need: rorg in a venv of pipx has no pip that a person would call."""
    if (Path(sys.prefix) / "pipx_metadata.json").exists():
        return "`pipx inject rorg matplotlib pygraphviz`"
    return "`pip install 'rorg[plots]'`"


def check_format(path: Path) -> None:
    """Raises Invalid if the name of a picture does not end in one of FORMATS."""
    if path.suffix not in FORMATS:
        raise Invalid(f"draw {path}", f"'{path.suffix}' is not a supported format", REMEDY)


def check_drawing(path: Path) -> None:
    """Raises Invalid if a picture of this name cannot be drawn here. Long commands check this first."""
    check_format(path)
    if find_spec("matplotlib") is None:
        raise Invalid(f"draw {path}", "matplotlib is not installed", install())


def save(make: Callable[[], Figure], path: Path) -> None:
    """Writes a figure, as its name says. The same figure always gives the same SVG. Raises Invalid if that is
    impossible."""
    check_drawing(path)
    # Its first run on a machine warns that it builds a cache of fonts, or that it has no folder for that.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    import matplotlib as mpl

    form = "png" if path.suffix == ".png" else "svg"
    with mpl.rc_context({"svg.hashsalt": "rorg", "svg.fonttype": "none", "font.size": 9}):
        drawn = io.BytesIO()
        make().savefig(drawn, format=form, dpi=150, metadata=None if form == "png" else {"Date": None})
    write(drawn.getvalue(), path)


def write(drawn: bytes, path: Path) -> None:
    """Writes what was drawn as PNG or SVG; an SVG as a page of its own if the name says so. Raises Invalid."""
    if path.suffix == ".html":
        svg = drawn.decode()
        drawn = PAGE.format(title=escape(path.stem), svg=svg[svg.index("<svg") :]).encode()
    try:
        path.write_bytes(drawn)
    except OSError as error:
        raise Invalid(f"draw {path}", error.strerror or str(error), "another file") from None
