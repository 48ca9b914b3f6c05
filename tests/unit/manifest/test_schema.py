"""schemas/ is what the models say, and TritonBot's manifests obey it."""

from __future__ import annotations

import json

import jsonschema
import pytest
import yaml
from common import ROOT

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


@pytest.mark.parametrize("name", ["day", "hour", "workload"])
def test_files_beside_a_tree_obey_their_schemas(name):
    value = yaml.safe_load((ROOT / "docs/evaluation" / f"{name}.yaml").read_text())
    schema = json.loads((ROOT / "schemas" / f"{value['kind'].lower()}.json").read_text())
    jsonschema.Draft202012Validator(schema).validate(value)


def test_a_spread_is_written_in_three_ways():
    schema = jsonschema.Draft202012Validator(json.loads((ROOT / "schemas/workload.json").read_text()))
    for cpu in (0.4, [0.3, 0.5], {"mean": 0.4, "deviation": 0.1}):
        spec = {"services": {"camera": {"cpu": {"active": cpu}, "start": "2s"}}}
        value = {"apiVersion": "rorg/v1", "kind": "Workload", "metadata": {"name": "one"}, "spec": spec}
        schema.validate(value)


def test_tritonbot_is_41_services_without_a_finding():
    loaded = load(ROOT / "manifests")
    assert loaded.diagnostics == ()
    assert sum(not s.meta for s in loaded.catalog.services.values()) == 41
