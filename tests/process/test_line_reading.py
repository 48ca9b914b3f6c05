"""What a command line means, and what help says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import get_args

import commands
import pytest
from command_samples import values
from hypothesis import given, settings
from hypothesis import strategies as st
from typer import BadParameter, Exit
from typer._click.exceptions import UsageError

from rorg.cli.app import about, typer_command
from rorg.cli.commands import COMMANDS, SUMMARIES
from rorg.cli.kinds import duration
from rorg.cli.mistakes import misread
from rorg.cli.options import SHARED, Engine
from rorg.model.engines import ENGINES

VARIABLES = ("RORG_STATE_DIR", "RORG_ENGINE", "RORG_GROUP")


TAKEN = [
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
    ("get", ["-ojson"]),
    ("get", ["-o", "json", "-o", "yaml"]),
    ("hold", ["arm", "--reason", "-w"]),
    ("exec", ["arm", "-it", "--", "sh"]),
    ("why", [""]),
]
REFUSED = [
    ("get", ["-o"]),
    ("get", ["--watch=yes"]),
    ("get", ["-o", "-w"]),
    ("why", []),
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


@pytest.mark.parametrize(("name", "words"), TAKEN, ids=lambda v: " ".join(v) if isinstance(v, list) else v)
def test_a_line_that_is_taken(name, words):
    assert values(name, words) == values(name, words, {"RORG_STATE_DIR": "/somewhere", "RORG_GROUP": ""})


@pytest.mark.parametrize(("name", "words"), REFUSED, ids=lambda v: " ".join(v) if isinstance(v, list) else v)
def test_a_line_that_is_refused(name, words):
    with pytest.raises(UsageError) as refused:
        values(name, words, {})
    assert re.fullmatch(f"cannot run `rorg {name}`: .*; try .*", str(misread(refused.value)))


def test_what_lines_mean():
    found = values("request", ["arm", "--ttl", "1m30s", "camera", "--priority=80", "--wait", "-oyaml"], {})
    assert list(found["services"]) == ["arm", "camera"]
    assert (found["ttl"], found["priority"], found["wait"], found["output"]) == (90.0, 80, True, "yaml")
    assert (found["timeout"], found["reason"], found["state_dir"]) == (60.0, "", None)
    assert values("get", ["-o", "json", "-o", "yaml"], {})["output"] == "yaml"
    assert values("get", ["-wo", "json"], {})["watch"]
    assert values("import", ["compose", "--profile", "a", "--profile=b"], {})["profile"] == ("a", "b")
    assert values("exec", ["arm", "-i", "--", "ls", "-la"], {})["command"] == ("ls", "-la")
    found = values("run-with", ["arm", "--timeout", "5", "--", "sh", "--", "--timeout", "7"], {})
    assert (found["program"], found["timeout"]) == (["sh", "--", "--timeout", "7"], 5.0)
    assert values("schema", [], {})["directory"] == Path("schemas")
    assert values("get", [], {"RORG_ENGINE": "process"})["engine"] == "process"
    assert values("get", ["--engine", "docker"], {"RORG_ENGINE": "process"})["engine"] == "docker"


def lines() -> st.SearchStrategy[tuple[str, list[str]]]:
    """Commands with their own options and others, in any order, with good values and bad ones."""
    found = st.sampled_from(
        ["arm", "base", "json", "10m", "3", "0.5", "101", "-1", "", "-", "--", "x=y", " 5", "1_0", "1e3", "ä", "a b"]
    )
    odd = st.sampled_from(["--help", "--nonsense", "-x", "--yes=1", "-oyaml", "--output=json", "--timeout=7", "--id="])

    def of(name: str) -> st.SearchStrategy[tuple[str, list[str]]]:
        names = [n for p in typer_command(name).params for n in p.opts if n.startswith("-")]
        words = st.lists(st.one_of(found, found, st.sampled_from(names or ["-h"]), odd), max_size=6)
        return words.map(lambda found: (name, found))

    return st.sampled_from(COMMANDS).flatmap(of)


@pytest.mark.slow
@settings(max_examples=400, deadline=None)
@given(lines(), st.dictionaries(st.sampled_from(VARIABLES), st.sampled_from(["", "/x", "docker"])))
def test_any_line_is_taken_or_refused_with_a_remedy(line, environment):
    try:
        values(*line, environment)
    except UsageError as error:
        assert misread(error).remedy  # noqa: PT017 - most lines raise nothing
    except Exit:
        assert {"--help", "-h"} & set(line[1])


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_shows_an_example_that_the_command_takes(name):
    line = about(name)[1]
    said = help_of(name)
    assert f"Example: {line}" in " ".join(said.split())
    assert not any(python in said for python in ("list[", "default: (", "None", "Path(")), said
    words = shlex.split(line.partition("<(")[2].rstrip(")") or line)
    assert words[:2] == ["rorg", name]
    assert values(name, words[2:], {}), line


def help_of(name: str) -> str:
    return commands.rorg(name, "--help").stdout


def test_help_shows_units():
    said = " ".join(help_of("request").split())
    assert "--timeout <duration>" in said
    assert "10s, 5m" in said
    assert "[default: 60 s]" in said
    assert "0<=x<=100" in said


@pytest.mark.slow
def test_shared_options_are_explained_once():
    said = commands.rorg("help", "options").stdout
    assert {word for word in said.split() if word.startswith("--")} == set(SHARED)
    for name in COMMANDS:
        explained, _, named = help_of(name).partition("More options: ")
        assert not [option for option in SHARED if f"  {option} " in explained], name
        assert not named or "see `rorg help options`" in " ".join(named.split())


def test_an_option_with_an_optional_value():
    assert [values("apply", line.split())["wait"] for line in ("", "--wait", "--wait=ready", "--wait=proven")] == [
        None,
        "ready",
        "ready",
        "proven",
    ]
    assert values("apply", ["--wait", "tree"])["directory"] == Path("tree")
    assert values("restart", ["arm", "--wait"])["wait"] is True


def test_the_engines_of_the_option_are_all():
    assert set(get_args(Engine)) == set(ENGINES)


def test_help_may_be_asked_for_in_several_ways():
    for line in (["help", "get"], ["get", "-h"], ["get", "arm", "--help"]):
        assert commands.rorg(*line).stdout == commands.rorg("get", "--help").stdout
    assert commands.rorg("help").stdout == commands.rorg("--help").stdout == commands.rorg().stdout
    said = commands.rorg("help").stdout
    assert all(f"  {name} " in said for name in COMMANDS)
    assert all(" ".join(summary.split()) in " ".join(said.split()) for summary in SUMMARIES.values())
    assert commands.rorg("version").stdout == commands.rorg("--version").stdout
    assert "no such command" in commands.rorg("help", "nosuch", code=2).stderr


@pytest.mark.parametrize("text", ["10", "10s", "0.5", "500ms", "1m30s", "", "10 s", "-1", "nan", "1e3", "1_0", "٣"])
def test_a_duration_needs_no_unit_and_seconds_are_meant(text):
    if text in ("10", "10s", "0.5", "500ms", "1m30s"):
        assert duration(text) == {"10": 10, "10s": 10, "0.5": 0.5, "500ms": 0.5, "1m30s": 90}[text]
    else:
        with pytest.raises(BadParameter, match="is not a duration"):
            duration(text)
