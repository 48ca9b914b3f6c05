"""JSON Schemas of the kinds, generated from the models: `python -m rorg.manifest.schema DIR [--check]`.

An editor that follows the modeline of a manifest completes and checks with them.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from rorg.manifest.models import API_VERSION, SPECS, Manifest


def schema(kind: str) -> dict[str, Any]:
    """The schema of one kind, its envelope included."""
    spec = SPECS[kind].model_json_schema(by_alias=True)
    envelope = Manifest.model_json_schema()
    definitions = {**envelope.pop("$defs", {}), **spec.pop("$defs", {})}
    envelope["properties"]["apiVersion"] = {"const": API_VERSION}
    envelope["properties"]["kind"] = {"const": kind}
    envelope["properties"]["spec"] = _loosen(spec)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": kind,
        **{k: v for k, v in envelope.items() if k != "title"},
        "$defs": _loosen(definitions),
    }


# What a validator turns into the model's type before it is checked: (type of the field, what may be written).
_WORDS = [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]
_SCALAR = {"type": ["string", "number"]}
_WRITTEN: dict[str, list[Any]] = {
    "command": _WORDS,
    "import": _WORDS,
    "entrypoint": _WORDS,
    "dns": _WORDS,
    "dns_opt": _WORDS,
    "dns_search": _WORDS,
    "env_file": _WORDS,
    "tmpfs": _WORDS,
    "gpus": [{"const": "all"}, {"type": "array"}],
    "test": _WORDS,
    "networks": [{"type": "array", "items": {"type": "string"}}, {"type": "object"}],
    "extra_hosts": [{"type": "array", "items": {"type": "string"}}, {"type": "object"}],
    "ports": [{"type": "array", "items": _SCALAR}],
    "expose": [{"type": "array", "items": _SCALAR}],
    "group_add": [{"type": "array", "items": _SCALAR}],
    "groups": [{"type": "array", "items": _SCALAR}],
    "user": [_SCALAR],
    "cpuset": [_SCALAR],
    "cpuset_mems": [_SCALAR],
    "cpus": [_SCALAR],
    "needs": [{"type": "array", "items": {"anyOf": [{"type": "string"}, {"$ref": "#/$defs/Need"}]}}],
    "exclusive": [{"type": "array", "items": {"type": "string"}}, {"type": "object"}],
    "ulimits": [
        {"type": "object", "additionalProperties": {"anyOf": [{"type": "integer"}, {"$ref": "#/$defs/Ulimit"}]}}
    ],
}
_PAIRS = ("environment", "labels", "annotations", "sysctls", "storage_opt", "options", "args", "driver_opts")


def _loosen(value: Any) -> Any:
    """The written forms of fields that accept several; everything else as pydantic says."""
    if isinstance(value, list):
        return [_loosen(item) for item in value]
    if not isinstance(value, dict):
        return value
    found = {k: _loosen(v) for k, v in value.items()}
    fields = found.get("properties")
    properties: dict[str, Any] = fields if isinstance(fields, dict) else {}
    for name, field in properties.items():
        written: list[Any] | None = _WRITTEN.get(name)
        if name in _PAIRS:
            written = [
                {"type": "object", "additionalProperties": _SCALAR},
                {"type": "array", "items": {"type": "string", "pattern": "="}},
            ]
        if written:
            kept = {k: v for k, v in field.items() if k in ("description", "default", "title", "x-rorg-change")}
            properties[name] = {"anyOf": [*written, {"type": "null"}], **kept}
    return found


def write(folder: Path, check: bool) -> list[str]:
    """Writes all schemas; with `check`, only says which files differ."""
    stale = []
    folder.mkdir(parents=True, exist_ok=True)
    for kind in SPECS:
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
