"""Snippets of the pages are right: manifests are whole and validate, command lines are ones that rorg takes."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import NamedTuple

import pytest
from command_samples import values
from common import ROOT
from typer._click.exceptions import UsageError

from rorg.cli.commands import ALIASES, COMMANDS
from rorg.manifest.documents import read_source
from rorg.manifest.traces import read_trace
from rorg.manifest.variables import read_variables
from rorg.manifest.workloads import read_workload
from rorg.model.diagnostics import collected
from rorg.store.requests_parser import parse

PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *(ROOT / "manifests/README.md", ROOT / "clients/ros1/README.md"),
    *(ROOT / "rorg/cli/first_robot/README.md", ROOT / "clients/example_ros2/README.md"),
]
BLOCK = re.compile(r"^( *)```(\w+)\n(.*?)^\1```", re.M | re.S)
PART = re.compile(r"# part of an? (\w+)\n")
"""The first line of a snippet that is only a part of a manifest."""
KINDS = ("Policy", "Group", "Image", "Network", "Volume", "Profile", "Request")
REST = {"Service": "spec:\n  image: robot\n", **dict.fromkeys(KINDS, "")}


class Snippet(NamedTuple):
    page: Path
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def snippets(*languages: str) -> list[Snippet]:
    found = []
    for page in PAGES:
        text = page.read_text()
        for block in BLOCK.finditer(text):
            if block[2] in languages:
                found.append(Snippet(page, text.count("\n", 0, block.start()) + 1, block[2], block[3]))
    return found


# -- YAML ------------------------------------------------------------------------------------------------------


BESIDE = re.compile(r"(?:#.*\n)?apiVersion: rorg/v1\nkind: (Trace|Workload)\n")
"""What stands beside a tree."""


def completed(text: str) -> str:
    """A part of a manifest with the rest around it."""
    kind = PART.match(text)[1]
    head = f"apiVersion: rorg/v1\nkind: {kind}\nmetadata: {{name: something}}\n"
    return head + text.replace("spec:\n", REST[kind] or "spec:\n", 1)


@pytest.mark.parametrize("snippet", snippets("yaml"), ids=str)
def test_yaml_is_a_manifest_that_validates(snippet, tmp_path):
    """Whole, or marked as a part in its first line; or what stands in the requests file."""
    text = snippet.text
    if text.startswith("# requests.yaml\n"):
        document, diagnostics = parse(text, str(snippet))
        assert not diagnostics
        assert document.requests
        return
    if kind := BESIDE.match(text):
        path = tmp_path / "beside.yaml"
        path.write_text(text)
        assert (read_trace if kind[1] == "Trace" else read_workload)(path)
        return
    if PART.match(text):
        text = completed(text)
    path = tmp_path / "services" / "snippet.yaml"
    for other in snippets("sh"):
        if other.page == snippet.page and other.text.startswith("# robot.env\n"):
            (tmp_path / "robot.env").write_text(other.text)
    variables, wrong = collected(read_variables(tmp_path, ""))
    assert not wrong
    source, diagnostics = read_source(text, path, str(snippet), tmp_path, variables)
    assert not diagnostics, "\n".join(map(str, diagnostics))
    assert source


def test_a_wrong_snippet_is_found(tmp_path):
    text = completed("# part of a Service\nspec:\n  idel: {linger: 2s}\n")
    assert "unknown key 'idel'" in str(read_source(text, tmp_path / "x.yaml", "x.yaml", tmp_path)[1][0])


# -- command lines ---------------------------------------------------------------------------------------------


def commands(text: str) -> list[list[str]]:
    """The words of every command line of a shell's text, without comments and what a program has answered."""
    found = []
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.shlex(line.removeprefix("$ "), posix=True, punctuation_chars=True)
        words.commenters, words.whitespace_split = "#", True
        command: list[str] = []
        for word in [*words, ";"]:
            if word and set(word) <= set("();<>|&"):
                found.append(command)
                command = []
            elif command or not re.match(r"\w+=", word):
                command.append(word)
    return [c for c in found if c]


def shell_lines() -> list[tuple[str, list[str]]]:
    found = []
    for snippet in snippets("sh", "console", "bash"):
        lines = [x for x in snippet.text.splitlines() if snippet.language != "console" or x.startswith("$ ")]
        found += [(str(snippet), c) for c in commands("\n".join(lines)) if c[0] == "rorg"]
    return found


def inline_lines() -> list[tuple[str, list[str]]]:
    """Those in the middle of sentences. A text with brackets or choices is a pattern, not a line."""
    found = []
    for page in PAGES:
        for match in re.finditer(r"`(rorg [a-z][^`\n]*)`", page.read_text()):
            if not re.search(r"[\[\]…]|\.\.\.|\w\|\w", match[1]):
                found.append((str(page.relative_to(ROOT)), shlex.split(match[1].partition(" | ")[0])))
    return found


def refused(words: list[str]) -> str:
    """Why rorg does not take a line; empty for one that it takes. Nothing is done."""
    if len(words) < 2 or words[1] not in (*COMMANDS, *ALIASES):
        own = words[1:] in (["--help"], ["--version"], ["version"]) or words[1:2] == ["help"]
        return "" if own else "no such command"
    if "--help" in words:
        return ""
    try:
        values(words[1], words[2:])
    except UsageError as error:
        return error.format_message()
    return ""


@pytest.mark.parametrize(("page", "words"), shell_lines(), ids=lambda v: v if isinstance(v, str) else shlex.join(v))
def test_a_command_line_is_taken(page, words):
    assert refused(words) == "", page


@pytest.mark.parametrize(("page", "words"), inline_lines(), ids=lambda v: v if isinstance(v, str) else shlex.join(v))
def test_a_command_in_a_sentence_is_taken(page, words):
    """It may be named without what it is about, as may its last option."""
    told = refused([word for word in words if word != "N"])
    assert not told or "Missing argument" in told or "requires an argument" in told, page


def test_a_wrong_command_line_is_found():
    lines = commands("cd x && A=1 rorg requset nav --wait &  # rorg nothing\nrorg get --color; ls | rorg why")
    found = [refused(c) for c in lines if c[0] == "rorg"]
    for told, why in zip(
        found, ("no such command", "No such option: --color", "Missing argument 'SERVICE'"), strict=True
    ):
        assert why in told


def test_there_are_snippets():
    assert len(snippets("yaml")) > 10
    assert len(shell_lines()) > 25
    assert len(inline_lines()) > 30
