"""Which API rorg speaks with an engine, by what the engine says of itself."""

from __future__ import annotations

import pytest

from rorg.engines.docker.release import Release, release

ANSWERS = [
    ({"server": "Docker/20.10.24+dfsg1 (linux)", "api-version": "1.41"}, Release("Docker", "20.10.24+dfsg1", (1, 41))),
    ({"server": "Docker/26.1.5+dfsg1 (linux)", "api-version": "1.45"}, Release("Docker", "26.1.5+dfsg1", (1, 45))),
    ({"server": "Docker/29.0.0 (linux)", "api-version": "1.52"}, Release("Docker", "29.0.0", (1, 45))),
    ({"server": "Libpod/4.3.1 (linux)", "api-version": "1.41"}, Release("Podman", "4.3.1", (1, 41))),
    ({"server": "Docker/1.9", "api-version": "1.9"}, Release("Docker", "1.9", (1, 9))),
    ({"server": "", "api-version": "nonsense"}, Release()),
    ({}, Release()),
]


@pytest.mark.parametrize(("headers", "expected"), ANSWERS)
def test_the_newest_api_that_both_know_is_spoken(headers, expected):
    assert release(headers) == expected


def test_versions_are_compared_as_numbers():
    assert release({"api-version": "1.9"}).api < release({"api-version": "1.10"}).api
