"""Makes the page of engines from docs/reference/engines.json, which `make engines` records."""

from __future__ import annotations

import json
from pathlib import Path

RECORD = Path(__file__).parent / "engines.json"
COLUMNS = (
    "Docker 20.10",
    "Docker 26",
    "Docker 26, containerd's image store",
    "Podman 4.3",
    "Podman 4.3, rootless",
    "processes",
)
ABOUT = """# Engines

rorg runs services on Docker, on Podman through Docker's API, or as [plain processes](../how-to/processes.md). The table
says what rorg needs of an engine, and which engine has it. A test tries each cell
(`tests/engines/test_engine_needs.py`).

- **yes**: the engine does it.
- **no: `engine-lacks`**: the engine ignores or refuses it. `rorg validate --machine` says so at the place in the
  manifest, with the code [engine-lacks](findings.md#engine-lacks).
- **no: something else**: rorg does that instead.

`rorg doctor` says which engine answers, and what it lacks. How rorg uses an engine, and what it does when the engine
does not answer, is in [What an engine does](../explanation/engines.md).

Podman was tried on a machine with control groups of version 1 and without systemd, where it lacks more than elsewhere:
without systemd it checks no health, and without root it has no control groups of version 1.

"""


def engines() -> str:
    """The page, without the note that it is generated."""
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    head = f"| rorg needs | {' | '.join(COLUMNS)} |\n|{'---|' * (1 + len(COLUMNS))}\n"
    rows = (f"| {need} | {' | '.join(cells[column] for column in COLUMNS)} |\n" for need, cells in record.items())
    return ABOUT + head + "".join(rows)
