"""Regular expressions of manifests. RE2 searches in time linear in the text; the standard library takes for ever over
a pattern like `(a+)+b` and a line of 35 characters, and holds the interpreter meanwhile."""

from __future__ import annotations

from functools import lru_cache
from typing import Any


@lru_cache(256)
def compiled(pattern: str) -> Any:
    """A pattern to search lines with: `^` and `$` are those of a line. Raises ValueError for what is none, or needs
    look-around or back-references, which take more than linear time."""
    import re2  # only robots with a log probe pay for it

    options = re2.Options()
    options.log_errors = False
    try:
        return re2.compile(f"(?m){pattern}", options)
    except re2.error as error:
        why = error.args[0] if error.args else ""
        text = why.decode(errors="replace") if isinstance(why, bytes) else str(why)
        raise ValueError(f"not a regular expression (of RE2): {text.replace('(?m)', '')}") from error
