"""Plays a week, or its first MINUTES, on a private engine, as root: play.py SEED MINUTES [RECORD]. Writes the record,
and the page and plot beside it: by default of a whole week in docs/evaluation, else in .venv."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from common import ROOT
from deployment import report
from deployment.auditor import save
from deployment.player import LIVE_RESTORE, Player, start_engine
from deployment.tour_guide import tour_guide
from deployment.week import WEEK, first, week
from dockerd import Dockerd, clean_up, import_base


def play(seed: int, seconds: float, folder: Path, path: Path, say: Callable[[str], None] = print) -> None:
    """Writes the record of a week, or of its first part, on an engine of its own; also if it is interrupted."""
    clean_up()
    engine = Dockerd(Path(subprocess.check_output(["mktemp", "-d", "/tmp/rorg-dockerd.XXXXXX"], text=True).strip()))
    engine.options = LIVE_RESTORE
    try:
        start_engine(engine)
        import_base(engine.host)
        player = Player(folder, engine)
        try:
            player.play(first(week(seed, tour_guide()), seconds), say)
        finally:
            player.close()
            save({"seed": seed, "seconds": seconds, "cores": os.cpu_count(), **player.auditor.record}, path)
    finally:
        engine.close()


def main(words: list[str]) -> int:
    seed, seconds = int(words[0]), min(WEEK, 60 * float(words[1]))
    path = Path(words[2]) if words[2:] else report.FIGURES if seconds == WEEK else ROOT / ".venv/deployment.json"
    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    with tempfile.TemporaryDirectory(prefix="rorg-week-") as folder:
        play(seed, seconds, Path(folder), path, lambda line: print(line, flush=True))
    report.write(path)
    print(f"{report.headline(report.read(path))}\n{path.with_suffix('.md')}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
