"""Every point of every scenario: `make proof`. Arguments are the names of scenarios; by default all."""

from __future__ import annotations

import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from proof import cases, scenarios
from proof.acts import Acts
from proof.world import Died

NAMES = ("SCENARIO", "POINT", "EVERY", "MOST", "STOP", "TWICE", "ORDER")
GIVEN = {name: os.environ.get(f"RORG_PROOF_{name}", "") for name in NAMES}
"""What to play: one scenario, one point of it, every so many points, at most so many, until the first violation;
whether the next rorg is killed too; and whether a loss of power keeps any of the operations without fsync."""
SEED = int(os.environ.get("RORG_TEST_SEED") or random.SystemRandom().getrandbits(32))
SHOWN = 3
"""Violations of a scenario that are shown with their log."""


def chosen(player: cases.Player) -> list[tuple[int, str]]:
    """The points to play, drawn by the seed unless all are wanted."""
    if GIVEN["POINT"]:
        point, _, side = GIVEN["POINT"].partition(":")
        return [(int(point), side or "after")]
    chance, every = random.Random(f"{SEED} {player.scenario.name}"), int(GIVEN["EVERY"] or 1)
    points = list(player.reordered() if GIVEN["ORDER"] else player.points())[chance.randrange(every) :: every]
    return chance.sample(points, min(len(points), int(GIVEN["MOST"]))) if GIVEN["MOST"] else points


def one_scenario(name: str, folder: Path, make: Callable[[Path], Acts]) -> list[cases.Result]:
    began = time.monotonic()
    try:
        player = cases.Player(scenarios.ALL[name], folder, make)
    except (AssertionError, Died) as error:
        log = (folder / "rorg.log").read_text(errors="replace")[-3000:]
        print(f"{name}: broken: {type(error).__name__} {error}\n{log}", flush=True)
        return [cases.Result(name, violations=[str(error)])]
    results: list[cases.Result] = []
    broken = 0
    for point, side in chosen(player):
        if GIVEN["TWICE"]:
            player.twice = random.Random(f"{SEED} {name} {point} {side}")
        results.append(player.play(point, side, bool(GIVEN["POINT"])))
        broken += bool(results[-1].violations)
        if results[-1].violations or GIVEN["POINT"]:
            print(results[-1] if broken <= SHOWN else str(results[-1])[:300], flush=True)
        if broken and GIVEN["STOP"]:
            break
    player.close()
    reached, seconds = sum(r.reached for r in results), time.monotonic() - began
    told = f"{len(player.effects)} effects, {len(results)} points ({reached} reached), {broken} violations"
    print(f"{name}: {told}, {seconds:.1f} s", flush=True)
    return results


def main(names: list[str], make: Callable[[Path], Acts] = Acts) -> int:
    print(f"RORG_TEST_SEED={SEED}", flush=True)
    folder, results = Path(tempfile.mkdtemp(prefix="rorg-proof.")), list[cases.Result]()
    try:
        for name in names or ([GIVEN["SCENARIO"]] if GIVEN["SCENARIO"] else scenarios.ALL):
            results += one_scenario(name, folder / name, make)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    broken = sum(bool(r.violations) for r in results)
    print(f"{len(results)} points, {broken} violations, {sum(r.seconds for r in results):.0f} s")
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
