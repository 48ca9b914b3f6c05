"""Every field of a manifest says what it means, how it is written and what holds without it, and that is so."""

from __future__ import annotations

import json
from typing import Annotated

import jsonschema
import pytest
from common import ROOT
from pydantic import TypeAdapter

from rorg.manifest.container import ContainerOptions
from rorg.manifest.field_texts import UNSET, fields_of, title
from rorg.manifest.models import ENVELOPES, SPECS
from rorg.manifest.schema import BESIDE, below, schema
from rorg.manifest.yaml_source import read_yaml
from rorg.model.units import parse_duration, parse_memory

MODELS = sorted(
    {m for top in (*ENVELOPES.values(), *SPECS.values(), *BESIDE.values()) for m in below(top)},
    key=lambda model: (title(model), model.__module__, model.__qualname__),
)
FIELDS = [(model, name) for model in MODELS for name in fields_of(model)]
IDS = [f"{title(model)}.{name}" for model, name in FIELDS]


def validator(model, name):
    field = next(f for n, f in model.model_fields.items() if (f.alias or n) == name)
    return TypeAdapter(Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation)


def test_all_kinds_and_their_parts_are_looked_at():
    assert {"Service", "Policy", "container", "Ulimit", "Escalate", "Metadata"} <= {title(m) for m in MODELS}
    assert len(FIELDS) > 190


@pytest.mark.parametrize(("model", "name"), FIELDS, ids=IDS)
def test_a_field_has_a_description_and_an_example_that_is_right(model, name):
    told = fields_of(model)[name]
    assert told.about.endswith((".", "...")), "a sentence"
    assert "Default:" not in told.about, "it has a place of its own"
    assert told.example is not None
    validator(model, name).validate_python(told.example)


@pytest.mark.parametrize(("model", "name"), FIELDS, ids=IDS)
def test_types_are_words_of_the_manifest(model, name):
    form = fields_of(model)[name].form
    assert not any(word in form for word in ("str", "int ", "float", "Annotated", "None")), form
    assert form != "anything" or (model, name) in [(envelope, "spec") for envelope in ENVELOPES.values()]


def test_a_default_is_what_holds_without_the_field():
    """As written, it is read as the value that the model has."""
    checked = 0
    for model in MODELS:
        for attribute, field in model.model_fields.items():
            name = field.alias or attribute
            default, told = field.get_default(call_default_factory=True), fields_of(model)[name]
            if isinstance(default, bool | int | float | str):
                document, _ = read_yaml(told.default, "default")
                assert validator(model, name).validate_python(document.value) == default, name
                checked += 1
    assert checked > 20


def test_durations_and_sizes_are_told_as_people_write_them():
    from rorg.manifest.policy import PolicySpec, Pressure
    from rorg.manifest.probes import Ready

    ready, policy = fields_of(Ready), fields_of(PolicySpec)
    assert (ready["timeout"].form, ready["timeout"].default) == ("duration", "30s")
    assert policy["resync"].default == "60s"
    assert fields_of(Pressure)["memory_some"].default == "20"
    options = fields_of(ContainerOptions)
    assert (options["mem_limit"].form, options["mem_limit"].example) == ("size", "512Mi")
    assert options["stop_grace_period"].default == "5s (profile common)"
    assert options["cpus"].form == "number of cores"
    assert options["annotations"].default == UNSET


@pytest.mark.parametrize("kind", SPECS)
def test_a_schema_tells_the_same_and_takes_its_own_examples(kind):
    written = schema(kind)
    tables = [written, written["properties"]["spec"], *written["$defs"].values()]
    for name, property in ((n, p) for t in tables for n, p in t.get("properties", {}).items()):
        where = f"{kind}: {name}"
        assert property["description"], where
        assert "x-rorg-default" not in property, where
        assert property.get("default", "") is not None, f"{where}: null is nothing to write"
        check = jsonschema.Draft202012Validator({**property, "$defs": written["$defs"]})
        if name != "spec":
            check.validate(property["examples"][0])
        if "default" in property:
            check.validate(property["default"])


def test_a_schema_takes_durations_and_sizes_with_and_without_units():
    linger = json.loads((ROOT / "schemas/service.json").read_text())["$defs"]["Idle"]["properties"]["linger"]
    check = jsonschema.Draft202012Validator(linger)
    assert all(check.is_valid(value) for value in ("20s", "1m30s", 20, 0.5, "20"))
    assert not any(check.is_valid(value) for value in (-1, "20 s", "soon", True))


@pytest.mark.parametrize(
    ("value", "seconds"), [("20s", 20), ("1m30s", 90), ("250ms", 0.25), (20, 20), (0.5, 0.5), ("20", 20), ("2.5", 2.5)]
)
def test_a_duration_without_a_unit_is_seconds(value, seconds):
    assert parse_duration(value) == seconds


@pytest.mark.parametrize("value", [-1, True, None, "-1", "", "20 s", "s", float("nan"), float("inf"), 1 << 5000, 1e300])
def test_what_is_no_duration_is_refused(value):
    with pytest.raises(ValueError, match=r"duration|ten years"):
        parse_duration(value)


@pytest.mark.parametrize(("value", "count"), [("180Mi", 180 << 20), ("1k", 1024), (4096, 4096), ("4096", 4096)])
def test_a_size_without_a_unit_is_bytes(value, count):
    assert parse_memory(value) == count
