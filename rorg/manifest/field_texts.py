"""The description of each field for people: type, default, example. Schemas, reference and `rorg explain` all use
it."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from rorg.manifest.container import ContainerOptions
from rorg.manifest.fields import Written, model_of
from rorg.manifest.models import FOLDERS, SPECS
from rorg.manifest.profiles import SHIPPED, built_in_profiles, declared
from rorg.model.units import format_duration

NAMES = {str: "text", int: "number", float: "number", bool: "true | false"}
UNSET = "not set"


@dataclass(frozen=True)
class FieldText:
    """One field. `example` is a value as it is written in YAML."""

    name: str
    about: str
    form: str
    """Its type in words, such as duration or list of name."""
    default: str
    example: Any
    required: bool
    change: str
    """Cost of a change: live, recreate or none; empty if this does not apply."""
    model: type[BaseModel] | None
    """The model of its value, or of the items of its value."""


def about(model: type[BaseModel]) -> str:
    """What a model is for; for a kind of manifest also the folder that its files must be in."""
    text = inspect.getdoc(model) or ""
    places = (f"{folder}/NAME.yaml" for folder, kind in FOLDERS.items() if SPECS[kind] is model)
    return "\n\n".join(
        [text, *(f"Its file is `{place}`, or it is directly in the tree's own directory." for place in places)]
    )


@cache
def fields_of(model: type[BaseModel]) -> dict[str, FieldText]:
    """All fields of a model by the names that people write."""
    fields = {}
    for attribute, field in model.model_fields.items():
        marks: Any = field.json_schema_extra or {}
        name = field.alias or attribute
        fields[name] = FieldText(
            name,
            field.description or "",
            type_of(field.annotation, field.metadata),
            _common(name) if model is ContainerOptions and _common(name) else _default(field, marks),
            (field.examples or [None])[0],
            field.is_required(),
            marks.get("x-rorg-change", ""),
            model_of(field.annotation),
        )
    return fields


def title(model: type[BaseModel]) -> str:
    """The name of a model in texts."""
    return "container" if model is ContainerOptions else model.__name__.removesuffix("Spec")


def inline(value: Any) -> str:
    """A value on one line, as YAML takes it."""
    import yaml

    text: str = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True)
    return text.removesuffix("...\n").strip()


def written(value: Any, kind: str) -> str:
    """A value as people write it; `kind` is the type of its field, in words."""
    if kind == "duration":
        return format_duration(value)
    if kind == "size" and value > 0:
        return next(f"{value // size}{unit}" for size, unit in _UNITS if value % size == 0)
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, dict | list):
        return inline(value)
    return value if isinstance(value, str) else json.dumps(value)


def written_mapping(value: Any, model: type[BaseModel] | None) -> Any:
    """A mapping or a list of the plain values of a model, with durations, sizes and numbers as people write them."""
    if isinstance(value, list):
        return [written_mapping(item, model) for item in value]
    if not isinstance(value, dict):
        return value
    return {key: _written_part(part, fields_of(model).get(key) if model else None) for key, part in value.items()}


def _written_part(value: Any, field: FieldText | None) -> Any:
    if isinstance(value, dict | list):
        return written_mapping(value, field.model if field else None)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    kind = next((k for k in ("duration", "size") if field and k in field.form.split(" | ")), "")
    if kind:
        return written(value, kind)
    return int(value) if value == int(value) else value


_UNITS = ((1 << 30, "Gi"), (1 << 20, "Mi"), (1 << 10, "Ki"), (1, ""))


def type_of(annotation: Any, marks: Iterable[Any] = ()) -> str:
    """A type in words of the manifest. `marks` are the annotations of a field."""
    if own := [mark.text for mark in marks if isinstance(mark, Written)]:
        return own[-1]
    args, origin = get_args(annotation), get_origin(annotation)
    if origin is Annotated:
        return type_of(args[0], args[1:])
    if origin is Literal:
        return " | ".join(map(str, args))
    if origin in (list, dict):
        return f"{'list' if origin is list else 'mapping'} of {type_of(args[-1])}"
    if args:
        return " | ".join(dict.fromkeys(type_of(a) for a in args if a is not type(None)))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return title(annotation)
    return NAMES.get(annotation, "anything")


def _default(field: FieldInfo, marks: Any) -> str:
    if field.is_required():
        return "required"
    if "x-rorg-default" in marks:
        return str(marks["x-rorg-default"])
    value = field.get_default(call_default_factory=True)
    if value is None or value == {} or value == [] or isinstance(value, BaseModel):
        return UNSET
    return written(value, type_of(field.annotation, field.metadata))


@cache
def _common(option: str) -> str:
    """The value that the built-in profile `common` gives to every container; empty if it gives none."""
    value = declared(built_in_profiles()[SHIPPED.name].spec.container).get(option)
    if value is None:
        return ""
    kind = type_of(ContainerOptions.model_fields[option].annotation)
    text = inline(value) if isinstance(value, dict | list) else written(value, kind)
    return f"{text} (profile {SHIPPED.name})"
