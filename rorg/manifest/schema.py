"""JSON Schemas of the kinds, generated from the models: `python -m rorg.manifest.schema DIR [--check]`.

An editor that follows the modeline of a manifest uses them to complete and to check.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from rorg.manifest.field_texts import UNSET, FieldText, fields_of
from rorg.manifest.models import API_VERSION, ENVELOPES, SPECS, Manifest
from rorg.manifest.traces import TraceSpec
from rorg.manifest.workloads import WorkloadSpec

BESIDE: dict[str, type[BaseModel]] = {"Trace": TraceSpec, "Workload": WorkloadSpec}
"""Kinds of documents outside a tree."""


def schema(kind: str) -> dict[str, Any]:
    """Returns the schema of one kind, envelope included."""
    model, form = {**SPECS, **BESIDE}[kind], ENVELOPES.get(kind, Manifest)
    spec = model.model_json_schema(by_alias=True)
    envelope = form.model_json_schema()
    definitions = {**envelope.pop("$defs", {}), **spec.pop("$defs", {})}
    models = {one.__name__: one for top in (form, model) for one in below(top)}
    for name, definition in ((form.__name__, envelope), (model.__name__, spec), *definitions.items()):
        _tell(definition, fields_of(models[name]))
    envelope["properties"]["apiVersion"] |= {"const": API_VERSION}
    envelope["properties"]["kind"] |= {"const": kind, "examples": [kind]}
    envelope["properties"]["spec"] = _loosen(spec)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": kind,
        **{k: v for k, v in envelope.items() if k != "title"},
        "$defs": _loosen(definitions),
    }


def below(model: type[BaseModel]) -> list[type[BaseModel]]:
    """Returns a model and every model below it, each once."""
    models = [model]
    for one in models:  # it grows during the loop
        models += [f.model for f in fields_of(one).values() if f.model and f.model not in models]
    return list(dict.fromkeys(models))


def _tell(definition: dict[str, Any], texts: Mapping[str, FieldText]) -> None:
    """Adds meaning, default and type of each field to its property, for editors to show."""
    for name, told in texts.items():
        subschema = definition["properties"][name]
        default = "" if told.required or told.default == UNSET else f" Default: {told.default}."
        subschema["description"] = f"{told.about}{default}\n\nType: {told.form}"
        subschema.pop("x-rorg-default", None)
        if isinstance(subschema.get("default"), int | float) and not isinstance(subschema["default"], bool):
            subschema["default"] = told.default if told.form in ("duration", "size") else subschema["default"]
        elif subschema.get("default", "") is None:
            del subschema["default"]  # null is the internal default; it is never written


_PLAIN = ("integer", "number", "boolean")
_VARIABLE = {"type": "string", "pattern": r"\$\{.+\}"}
_TOLD = ("description", "default", "examples", "title", "x-rorg-change")


def _loosen(value: Any) -> Any:
    """Allows variables in all fields; the rest stays as pydantic generates it."""
    if isinstance(value, list):
        return [_loosen(item) for item in value]
    if not isinstance(value, dict):
        return value
    mapping = {k: _loosen(v) for k, v in value.items()}
    if isinstance(fields := mapping.get("properties"), dict):
        mapping["properties"] = {name: _or_variable(field) for name, field in fields.items()}
    return mapping


def _or_variable(field: dict[str, Any]) -> dict[str, Any]:
    """Allows a variable of robot.env in place of a number or a boolean."""
    if field.get("type") in _PLAIN:
        kept = {k: v for k, v in field.items() if k in _TOLD}
        return {"anyOf": [{k: v for k, v in field.items() if k not in _TOLD}, _VARIABLE], **kept}
    forms = field.get("anyOf", ())
    if any(form.get("type") in _PLAIN for form in forms) and not any(form.get("type") == "string" for form in forms):
        return {**field, "anyOf": [*forms, _VARIABLE]}
    return field


def write(folder: Path, check: bool) -> list[str]:
    """Writes all schemas and returns the names of outdated files; with `check`, writes nothing."""
    stale = []
    folder.mkdir(parents=True, exist_ok=True)
    for kind in (*SPECS, *BESIDE):
        path = folder / f"{kind.lower()}.json"
        text = json.dumps(schema(kind), indent=1, sort_keys=True) + "\n"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            stale.append(path.name)
            if not check:
                path.write_text(text, encoding="utf-8")
    return stale


if __name__ == "__main__":
    differing = write(Path(sys.argv[1]), "--check" in sys.argv)
    if "--check" in sys.argv and differing:
        sys.exit(f"stale: {', '.join(differing)}; try `make schemas`")
