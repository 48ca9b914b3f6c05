"""An editor that tests script."""

from __future__ import annotations

EDITOR = "import sys, pathlib; path = pathlib.Path(sys.argv[1]); text = path.read_text(); "
