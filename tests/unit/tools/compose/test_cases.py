"""Reading Compose files: what comes out is what Docker Compose makes of them (tests/cases/compose)."""

from __future__ import annotations

import pytest
from compose_cases import cases, differences, load_case, ours, theirs


@pytest.mark.parametrize("name", cases())
def test_a_case_is_what_compose_makes_of_it(name):
    loaded = load_case(name)
    assert loaded.project is not None, "\n".join(map(str, loaded.errors))
    assert not differences(ours(loaded.project), theirs(name))
