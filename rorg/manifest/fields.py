"""How fields of manifests are declared: meaning, example, default, and the cost of a change. The JSON schemas, the
reference pages and `rorg explain` are generated from these declarations."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, get_args

from pydantic import BaseModel, Field, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue

TEXT = {"type": "string"}
TEXTS = {"type": "array", "items": TEXT}
SCALAR = {"type": ["string", "number"]}


class Written:
    """An annotation: the type of a field as people read it. `also`: JSON schemas of the forms that a validator converts
    to that type."""

    def __init__(self, text: str, *also: Mapping[str, Any]) -> None:
        self.text, self.also = text, also

    def __get_pydantic_json_schema__(self, schema: Any, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        json_schema = handler(schema)
        return {"anyOf": [*self.also, json_schema]} if self.also else json_schema


def field(about: str, example: Any, default: Any = None, *, unset: str = "", change: str = "", **more: Any) -> Any:
    """Declares a field of a manifest. A callable `default` is called for each instance; `...` makes the field required.
    `unset` describes what applies when a field whose default is None is left out."""
    marks: dict[str, Any] = {"x-rorg-change": change} if change else {}
    if unset:
        marks["x-rorg-default"] = unset
    given: dict[str, Any] = {"default_factory": default} if callable(default) else {"default": default}
    return Field(**given, description=about, examples=[example], json_schema_extra=marks, **more)


recreate = partial(field, change="recreate")
"""Declares a field whose change needs a new container."""
live = partial(field, change="live")
"""Declares a field that the engine changes in place."""
unchanging = partial(field, change="none")
"""Declares a field whose change does not touch a running container."""


def model_of(annotation: Any) -> type[BaseModel] | None:
    """The model of a field, or of the items of its value; None if it has none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(model_of, get_args(annotation))), None)
