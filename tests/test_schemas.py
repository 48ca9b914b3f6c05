"""schemas/ is what the models say, and TritonBot's manifests obey it."""

from __future__ import annotations

import json

import jsonschema
import pytest
import yaml
from conftest import ROOT

from rorg.manifest.documents import manifest_files
from rorg.manifest.load import load
from rorg.manifest.schema import write


def test_schemas_are_current():
    assert write(ROOT / "schemas", check=True) == []


@pytest.mark.parametrize("path", manifest_files(ROOT / "manifests"), ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_manifest_obeys_its_schema(path):
    text = path.read_text()
    modeline, value = text.splitlines()[0], yaml.safe_load(text)
    assert modeline == f"# yaml-language-server: $schema=../../schemas/{value['kind'].lower()}.json"
    schema = json.loads((ROOT / "schemas" / f"{value['kind'].lower()}.json").read_text())
    jsonschema.Draft202012Validator(schema).validate(value)


def test_tritonbot_is_41_services_without_a_finding():
    loaded = load(ROOT / "manifests")
    assert loaded.diagnostics == ()
    assert sum(not s.meta for s in loaded.catalog.services.values()) == 41
