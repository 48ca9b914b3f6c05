"""A command line means the same, whether it is read plainly or by typer; what is not plain is left to typer."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
import typer
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from rorg.cli import plain
from rorg.cli.app import about, add, app
from rorg.cli.commands import COMMANDS, command_of
from rorg.cli.options import Option, duration
from rorg.cli.signature import parameters

DECLARED = {name: parameters(command_of(name)) for name in COMMANDS}
VARIABLES = ("RORG_STATE_DIR", "RORG_ENGINE", "RORG_GROUP")
SAID: dict[str, list[dict]] = {name: [] for name in COMMANDS}


def recording(name: str) -> typer.Typer:
    found = typer.Typer(add_completion=False)
    add(found, command_of(name), run=lambda **values: SAID[name].append(values))
    return found


TYPERS = {name: recording(name) for name in COMMANDS}


def by_typer(name: str, words: list[str], environment: dict[str, str]) -> dict | None:
    """What typer hands to the command; None where it tells an error, or shows help."""
    SAID[name].clear()
    CliRunner().invoke(TYPERS[name], words, env={**dict.fromkeys(VARIABLES), **environment})
    return SAID[name][0] if SAID[name] else None


def same(name: str, words: list[str], environment: dict[str, str]) -> bool:
    """Holds both ways equal, and says whether the line is plain."""
    found = plain.read(DECLARED[name], words, environment)
    if found is None:
        return False
    other = by_typer(name, words, environment)
    assert found == other
    assert {k: type(v) for k, v in found.items()} == {k: type(v) for k, v in other.items()}
    return True


PLAIN = [
    ("get", []),
    ("get", ["services", "arm", "-o", "json"]),
    ("get", ["arm", "base", "-l", "site=lab", "--group", "driving", "--sort-by", "age"]),
    ("get", ["--output=yaml", "groups", "-w"]),
    ("get", ["--manifests", "tree", "--state-dir", "/x", "--engine", "process"]),
    ("why", ["arm"]),
    ("request", ["arm", "camera", "--id", "tour", "--ttl", "1m30s", "--priority", "80", "--wait", "--timeout", "2.5"]),
    ("request", ["arm", "--as", "guide", "--reason", "a visitor — with a dog"]),
    ("release", ["tour", "--as", "guide"]),
    ("restart", ["arm", "-y", "--wait"]),
    ("hold", ["arm", "base", "--for", "10m"]),
    ("hold", ["arm", "--for", "90"]),
    ("hold", ["arm", "--for", "10"]),
    ("hold", ["arm", "--end"]),
    ("top", ["--interval", "500ms"]),
    ("suspend", ["--for", "1h", "--reason", "x"]),
    ("wait", ["arm", "--timeout", "5"]),
    ("wait", ["arm", "--timeout", "1m30s", "-o", "json"]),
    ("diff", ["tree", "-o", "json"]),
    ("diff", ["-u", "--service", "arm"]),
    ("run-with", ["arm", "base", "--timeout", "5", "--", "sh", "-c", "x", "--", "--timeout", "7"]),
    ("apply", ["--yes", "--wait"]),
    ("events", ["-f", "--tail", "3"]),
    ("run", ["tree", "--listen", "0.0.0.0:1", "--tls-cert", "c.pem"]),
    ("build", ["arm", "base", "--manifests", "tree", "--pull", "-j", "2"]),
    ("build", ["--no-cache", "--dry-run", "-o", "json"]),
    ("demo", ["--speed", "2"]),
    ("completion", ["bash"]),
    ("exec", ["arm", "-i", "--", "ls", "-la", "--", "x"]),
    ("shell", ["arm"]),
    ("cp", ["arm:/a", "."]),
    ("edit", ["group/seeing"]),
]
NOT_PLAIN = [
    ("get", ["--help"]),
    ("get", ["-h"]),
    ("get", ["-ojson"]),
    ("get", ["-o"]),
    ("get", ["--watch=yes"]),
    ("get", ["-o", "json", "-o", "yaml"]),
    ("get", ["-o", "-w"]),
    ("why", []),
    ("why", [""]),
    ("why", ["arm", "--outptu", "json"]),
    ("request", ["--id", "x"]),
    ("request", ["arm", "--ttl", "soon"]),
    ("request", ["arm", "--priority", "101"]),
    ("request", ["arm", "--priority", "1.5"]),
    ("request", ["arm", "--timeout", "nan"]),
    ("hold", ["arm", "--for", "ten"]),
    ("hold", ["arm", "--for", "10 m"]),
    ("events", ["--tail", "-1"]),
    ("top", ["--interval", "0.1"]),
    ("top", ["--interval", "100ms"]),
    ("build", ["--jobs", "0"]),
]


@pytest.mark.parametrize(("name", "words"), PLAIN, ids=lambda v: " ".join(v) if isinstance(v, list) else v)
def test_a_plain_line_means_what_typer_says(name, words):
    assert same(name, words, {})
    assert same(name, words, {"RORG_STATE_DIR": "/somewhere", "RORG_ENGINE": "process", "RORG_GROUP": ""})


@pytest.mark.parametrize(("name", "words"), NOT_PLAIN, ids=lambda v: " ".join(v) if isinstance(v, list) else v)
def test_whatever_is_unusual_is_left_to_typer(name, words):
    assert plain.read(DECLARED[name], words, {}) is None


def lines() -> st.SearchStrategy[tuple[str, list[str]]]:
    """Commands with their own options and others, in any order, with good values and bad ones."""
    values = st.sampled_from(
        ["arm", "base", "json", "10m", "3", "0.5", "101", "-1", "", "-", "--", "x=y", " 5", "1_0", "1e3", "ä", "a b"]
    )
    odd = st.sampled_from(["--help", "--nonsense", "-x", "--yes=1", "-oyaml", "--output=json", "--timeout=7", "--id="])

    def of(name: str) -> st.SearchStrategy[tuple[str, list[str]]]:
        names = [n for p in DECLARED[name] if isinstance(p.declared, Option) for n in p.declared.names]
        words = st.lists(st.one_of(values, values, st.sampled_from(names or ["-h"]), odd), max_size=6)
        return words.map(lambda found: (name, found))

    return st.sampled_from(COMMANDS).flatmap(of)


@settings(max_examples=400, deadline=None)
@given(lines(), st.dictionaries(st.sampled_from(VARIABLES), st.sampled_from(["", "/x", "docker"])))
def test_any_line_means_what_typer_says_or_is_left_to_it(line, environment):
    same(*line, environment)


def test_no_command_but_those_of_typer_imports_it():
    """What a command imports before it begins is what every use of it costs."""
    folder = Path(plain.__file__).parent
    found = {p.name for p in folder.rglob("*.py") if "\nimport typer" in p.read_text()}
    assert found == {"app.py"}


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_shows_an_example_that_the_command_takes(name):
    line = about(command_of(name))[1]
    assert f"Example: {line}" in " ".join(CliRunner().invoke(app, [name, "--help"], terminal_width=200).output.split())
    words = shlex.split(line.partition("<(")[2].rstrip(")") or line)
    assert words[:2] == ["rorg", name]
    assert by_typer(name, words[2:], {}) is not None, line


def test_help_shows_units():
    said = " ".join(CliRunner().invoke(app, ["request", "--help"], terminal_width=200).output.split())
    assert "--timeout DURATION" in said
    assert "10s, 5m" in said
    assert "[default: (60s)]" in said


@pytest.mark.parametrize("text", ["10", "10s", "0.5", "500ms", "1m30s", "", "10 s", "-1", "nan", "1e3", "1_0", "٣"])
def test_a_duration_needs_no_unit_and_seconds_are_meant(text):
    if text in ("10", "10s", "0.5", "500ms", "1m30s"):
        assert duration(text) == {"10": 10, "10s": 10, "0.5": 0.5, "500ms": 0.5, "1m30s": 90}[text]
    else:
        with pytest.raises(ValueError, match="is not a duration"):
            duration(text)
