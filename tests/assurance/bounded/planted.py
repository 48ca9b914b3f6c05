"""Plants a defect in a copy of rorg, and explores a world with it in a process of its own.

As a program it is that process: it explores the world of the named defect until the first violation, and prints it.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from bounded.bounds import slice_of
from bounded.defects import DEFECTS, Defect
from bounded.explore import Bound, Explorer, Found, Tally, replay
from bounded.walks import Tally as Walked
from bounded.walks import broken
from bounded.worlds import World, specs_of
from common import ASSURANCE, ROOT, SUPPORT

import rorg

QUICK = (0.03,)


def plant(defect: Defect, folder: Path) -> Path:
    """Return the folder of a copy of rorg with this defect."""
    shutil.copytree(ROOT / "rorg", folder / "rorg", symlinks=True)
    path = folder / "rorg" / defect.file
    text = path.read_text()
    assert text.count(defect.old) == 1, f"{defect.name}: {defect.file} has changed; say it again in defects.py"
    path.write_text(text.replace(defect.old, defect.new))
    return folder


def caught(defect: Defect, folder: Path, seconds: float = 240.0) -> str:
    """Return the invariant that catches a defect; empty if none does."""
    paths = [str(plant(defect, folder)), *map(str, (ROOT / "clients/python", ASSURANCE, SUPPORT))]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-m", "bounded.planted", defect.name]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=seconds)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout.splitlines()[-1])
    assert Path(said["rorg"]).is_relative_to(folder), said["rorg"]
    return str(said["caught"])


def hunt(defect: Defect) -> Tally:
    """Walk, or explore the world of a defect, until a promise breaks."""
    world = World(specs_of(defect.features, defect.services), defect.name)
    bound = Bound(defect.services, 0, defect.steps, False, QUICK)
    tally = Tally()
    if defect.walk:
        violation = broken(defect.walk, Walked())
        tally.found += [Found(world, (), violation)] if violation else []
        return tally
    if defect.path:
        found = replay(world, defect.path)
        tally.found += [found] if found else []
        return tally
    Explorer(world, bound, tally, first=True).run()
    return tally if tally.found else slice_of(1, tally)


def main() -> None:
    """Print which rorg it was, and which invariant caught the defect."""
    defect = next(d for d in DEFECTS if d.name == sys.argv[1])
    tally = hunt(defect)
    name = tally.found[0].violation.name if tally.found else ""
    print(f"{tally}\n{tally.found[0] if tally.found else ''}", file=sys.stderr)
    print(json.dumps({"rorg": rorg.__file__, "caught": name}))


if __name__ == "__main__":
    main()
