"""Every mistake in a manifest is told with its place and a remedy. Each folder of cases/broken is a small tree with a
mistake, and the file `expected` in it holds the exact lines."""

from __future__ import annotations

from pathlib import Path

import pytest
from common import ROOT

from rorg.manifest.load import load
from rorg.manifest.yaml_source import read_yaml

CASES = sorted(p for p in (ROOT / "tests/cases/broken").iterdir() if p.is_dir())


@pytest.mark.slow
@pytest.mark.parametrize("folder", CASES, ids=lambda p: p.name)
def test_every_mistake_is_told_at_its_place(folder, monkeypatch):
    monkeypatch.chdir(folder)
    loaded = load(Path("."))
    assert loaded.catalog is None
    lines = [str(d).replace(f"{folder.resolve()}/", "") for d in loaded.diagnostics]
    assert lines == (folder / "expected").read_text(encoding="utf-8").splitlines()


def test_mistakes_of_several_files_come_at_once_and_sorted(monkeypatch, tmp_path):
    """One tree with the mistakes of several files: no error hides another's, and they come sorted by place."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "services").mkdir()
    for name in ("z1", "a1", "m1"):
        text = f"apiVersion: rorg/v1\nkind: Service\nmetadata: {{name: {name}}}\nspec: {{image: robot, nedes: []}}\n"
        (tmp_path / f"services/{name}.yaml").write_text(text, encoding="utf-8")
    lines = [str(d) for d in load(Path(".")).diagnostics]
    tail = "4:22: error: unknown key 'nedes'; try 'needs'"
    assert lines == [f"services/{name}.yaml:{tail}" for name in ("a1", "m1", "z1")]


def test_enough_cases():
    assert len(CASES) >= 30


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("NO", "NO"),
        ("no", "no"),
        ("on", "on"),
        ("yes", "yes"),
        ("true", True),
        ("FALSE", False),
        ("1:30", "1:30"),
        ("0o17", 15),
        ("017", 17),
        ("0x1F", 31),
        ("1_000", "1_000"),
        (".5", 0.5),
        ("1e3", 1000.0),
        ("-12", -12),
        ("~", None),
        ("null", None),
        ("", None),
        ("'~'", "~"),
        ("'12'", "12"),
        ("2026-01-01", "2026-01-01"),
        ("=", "="),
        ("host", "host"),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text, value):
    document, diagnostics = read_yaml(f"key: {text}\n", "case.yaml")
    assert diagnostics == []
    assert document.value == {"key": value}
    assert type(document.value["key"]) is type(value)


def test_keys_are_text_whatever_they_look_like():
    document, diagnostics = read_yaml("NO: a\n1: b\ntrue: c\n", "case.yaml")
    assert (document.value, diagnostics) == ({"NO": "a", "1": "b", "true": "c"}, [])
