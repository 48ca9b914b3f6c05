"""Building several images at once against one after the other, in turns: no slower on any graph, faster on a wide
one."""

from __future__ import annotations

import os
import time

import pytest
from common import BASE_IMAGE
from image_trees import Place, images, orders_of

TURNS = 8
WIDE = {f"wide{n}": BASE_IMAGE for n in range(6)}
DEEP = {f"deep{n}": f"deep{n - 1}" if n else BASE_IMAGE for n in range(6)}
WORK = "RUN python3 -S -c 'import time; time.sleep(0.4)' {}"
"""What a step waits for is mostly a disk or a network."""


@pytest.mark.parametrize("kind", ["buildkit", "classic"])
@pytest.mark.parametrize(("shape", "parents"), [("wide", WIDE), ("deep", DEEP)])
def test_at_once_is_no_slower_than_one_after_the_other(dockerd, tmp_path, kind, shape, parents):
    place = Place(dockerd.host, kind == "buildkit", tmp_path / "builds")
    jobs = min(os.cpu_count() or 1, 4)
    took: dict[int, list[float]] = {1: [], jobs: []}
    try:
        for turn in range(TURNS):
            with_jobs = (1, jobs, jobs, 1)[turn % 4]
            # Another command each time: what an engine has kept costs nothing.
            text = {name: f"FROM {below}\n{WORK.format(f'{kind}{turn}')}\n" for name, below in parents.items()}
            orders = orders_of(images(tmp_path / str(turn), text), {BASE_IMAGE}, identity=f"{turn}" * 64)
            began = time.monotonic()
            results = place.build(orders, jobs=with_jobs)
            took[with_jobs].append(time.monotonic() - began)
            assert {r.outcome for r in results.values()} == {"present", "built"}, results
    finally:
        place.close()
    alone, together = min(took[1]), min(took[jobs])
    print(f"\n{shape}, {kind}: {alone:.2f} s one by one, {together:.2f} s with {jobs}; ratio {together / alone:.2f}")
    assert together < (0.9 if shape == "wide" and jobs > 1 else 1.15) * alone
