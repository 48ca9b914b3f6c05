"""Commands of Compose files that are one text: split as Compose 2.26.1 splits them (`docker compose config`)."""

from __future__ import annotations

import pytest

from rorg.tools.compose.command_line import split


@pytest.mark.parametrize(
    ("text", "words", "rest"),
    [
        ("ros2 launch  nav nav.launch.py", ["ros2", "launch", "nav", "nav.launch.py"], ""),
        ("a\\ b 'c d'\"e\\nf\" `x y` g", ["a b", "c denf", "`x y`", "g"], ""),
        ("echo '' \"\" a''b", ["echo", "", "", "ab"], ""),
        ("echo $(ls -l) x", ["echo", "$(ls -l)", "x"], ""),
        ("bash -c 'source x && y'", ["bash", "-c", "source x && y"], ""),
        ("echo hello && sleep 1", ["echo", "hello"], "&& sleep 1"),
        ("a 2>x b", ["a"], ">x b"),
        ("echo a>b; c", ["echo", "a"], ">b; c"),
        ("", [], ""),
    ],
)
def test_words(text, words, rest):
    assert split(text) == (words, rest)


@pytest.mark.parametrize("text", ["a (b)", "a b)", "'a", '"a', "`a", "a \\", "a $(b"])
def test_what_compose_refuses(text):
    with pytest.raises(ValueError, match="not a command line"):
        split(text)
