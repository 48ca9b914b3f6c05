"""Regular expressions of manifests, matched by RE2 in time linear in the text.

The standard library takes forever on a pattern like `(a+)+b` and a line of 35 characters, and blocks the interpreter
meanwhile.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any


@lru_cache(256)
def compiled(pattern: str) -> Any:
    """Compiles a pattern to search lines: `^` and `$` match at line ends. Raises ValueError for an invalid pattern, and
    for look-around and back-references, which need more than linear time."""
    import re2  # only robots with a log probe pay for it

    options = re2.Options()
    options.log_errors = False
    try:
        return re2.compile(f"(?m){pattern}", options)
    except re2.error as error:
        why = error.args[0] if error.args else ""
        text = why.decode(errors="replace") if isinstance(why, bytes) else str(why)
        raise ValueError(f"not a regular expression (of RE2): {text.replace('(?m)', '')}") from error
