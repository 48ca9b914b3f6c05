"""Writes the OpenAPI document of the API: `python -m rorg.api.openapi FILE`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any


def document() -> dict[str, Any]:
    """The document, of an application without a running loop."""
    from rorg.api.app import make_app

    return make_app(None).openapi()  # type: ignore[arg-type]


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(document(), indent=1, sort_keys=True) + "\n", encoding="utf-8")
