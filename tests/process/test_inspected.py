"""The questions about memory that a soak asks do not disturb the program that they are about."""

from __future__ import annotations

import dataclasses
import threading

import inspected
import pytest


@dataclasses.dataclass
class Pair:
    values: tuple[int, ...]


@pytest.mark.slow
def test_objects_are_counted_without_disturbing_other_threads():
    """A thread that makes tuples meets `SystemError: bad argument to internal function` if another one holds them."""
    done, errors = threading.Event(), []

    def make_tuples() -> None:
        pair = Pair(tuple(range(200)))
        try:
            while not done.is_set():
                dataclasses.asdict(pair)
        except SystemError as error:
            errors.append(error)

    makers = [threading.Thread(target=make_tuples) for _ in range(3)]
    for maker in makers:
        maker.start()
    counts = [inspected.types() for _ in range(6)]
    done.set()
    for maker in makers:
        maker.join()
    assert not errors
    assert all(count["builtins.function"] > 1000 for count in counts)
