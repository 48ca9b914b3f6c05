"""schemas/ is what the models say, and TritonBot's manifests obey it."""

from __future__ import annotations

import json

import jsonschema
import pytest
import yaml
from common import ROOT

from rorg.manifest.documents import manifest_files
from rorg.manifest.load import load
from rorg.manifest.schema import schema, write


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


def test_the_length_of_names_is_as_it_is_described(tmp_path):
    """Docker refuses containers whose names have one letter, and so does rorg for each engine."""
    text = "apiVersion: rorg/v1\nkind: Service\nmetadata: {{name: {}}}\nspec: {}\n"
    (tmp_path / "services").mkdir()

    def accepted(name: str, spec: str = "{image: i}") -> bool:
        (tmp_path / f"services/{name}.yaml").write_text(text.format(name, spec))
        errors = load(tmp_path, engine="process").errors
        (tmp_path / f"services/{name}.yaml").unlink()
        return not errors

    assert [n for n in (1, 2, 63, 64) if accepted("a" * n)] == [2, 63]
    assert accepted("a", "{image: i, container: {container_name: arm}}")
    description = json.dumps(schema("Service"))
    assert "2 to 63 letters" in description
    assert "a service with a container_name" in description
