"""The forms that values are written in: words, pairs, cores, durations, sizes, names. Each form is converted to one
type."""

from __future__ import annotations

import shlex
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints, WithJsonSchema

from rorg.manifest import option_checks as check
from rorg.manifest.fields import SCALAR, TEXT, TEXTS, Written
from rorg.model import image_names
from rorg.model.units import DURATION, MEMORY, NAME, parse_duration, parse_memory

MIB = 1 << 20
LEAST_MEMORY = 6 * MIB
"""Bytes. The engine refuses a smaller memory limit."""
MOST = float(1 << 62)


class Strict(BaseModel):
    """The base of all models: unknown keys are errors, and scalars are never converted to another type."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class NotTextError(ValueError):
    """A number or a boolean where a text is meant; YAML reads it as a text if it has quotes."""


def _text_or_list(value: object) -> object:
    """Refuses what YAML reads as a number or a boolean. pydantic would ask for a list, and quotes are enough."""
    if isinstance(value, int | float):
        raise NotTextError
    return value


def _words(value: object) -> object:
    if not isinstance(value, str):
        return _text_or_list(value)
    try:
        return shlex.split(value)
    except ValueError as error:
        raise ValueError(f"not a command line: {error}") from error


def one_or_many(value: object) -> object:
    """Converts a single text to a list."""
    return [value] if isinstance(value, str) else _text_or_list(value)


def _pairs(value: object) -> object:
    """Converts `[K=V]` to {K: "V"}; `{K: V}` stays. Numbers and booleans become text later, as in Compose."""
    if isinstance(value, list):
        if not all(isinstance(item, str) and "=" in item for item in value):
            raise ValueError("each item must read KEY=VALUE")
        return dict(item.split("=", 1) for item in value)
    if isinstance(value, str):
        raise ValueError("must be a mapping, or a list of KEY=VALUE")
    return value


def _scalar(value: object) -> object:
    """Compose accepts true and false in mappings of text, and reads them as these words."""
    return _text(("false", "true")[value] if isinstance(value, bool) else value)


def _bare(value: object) -> object:
    """A label without a value has an empty value, as in Compose."""
    if isinstance(value, list):
        return [f"{item}=" if isinstance(item, str) and "=" not in item else item for item in value]
    return {k: "" if v is None else v for k, v in value.items()} if isinstance(value, dict) else value


def _text(value: object) -> object:
    if value is None:
        raise ValueError("a value is missing; write it, or '' for an empty one")
    if isinstance(value, bool):
        raise ValueError("true and false must be quoted here")
    return str(value) if isinstance(value, int | float) else value


def _cores(value: object) -> object:
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        raise ValueError(f"'{value}' is not a number of cores; write 0.5") from None


def _not_ours(value: dict[str, str]) -> dict[str, str]:
    if any(name.startswith("rorg.io/") for name in value):
        raise ValueError("labels that begin with rorg.io/ are rorg's own")
    return value


Duration = Annotated[
    float,
    BeforeValidator(parse_duration),
    WithJsonSchema({"anyOf": [{"type": "number", "minimum": 0}, {"type": "string", "pattern": DURATION}]}),
    Written("duration"),
]
Interval = Annotated[Duration, Field(ge=0.05)]
"""The interval of something periodic."""
Memory = Annotated[
    int,
    BeforeValidator(parse_memory),
    WithJsonSchema({"anyOf": [{"type": "integer", "minimum": -1}, {"type": "string", "pattern": MEMORY}]}),
    Written("size"),
]
Name = Annotated[str, StringConstraints(pattern=NAME, strict=True), Written("name")]


def _image_name(value: str) -> str:
    image_names.check_name(value)
    return value


ImageName = Annotated[
    str,
    AfterValidator(_image_name),
    WithJsonSchema({"type": "string", "pattern": image_names.NAME, "maxLength": image_names.LONGEST}),
    Written("image name"),
]


Words = Annotated[list[str], BeforeValidator(_words), Written("text | list of text", TEXT)]
Text = Annotated[str, BeforeValidator(_text), WithJsonSchema(SCALAR), Written("text")]
Scalar = Annotated[
    str, BeforeValidator(_scalar), WithJsonSchema({"type": ["string", "number", "boolean", "null"]}), Written("text")
]
Pairs = Annotated[dict[str, Scalar], BeforeValidator(_pairs), Written("mapping of text | list of KEY=VALUE", TEXTS)]
Labels = Annotated[Pairs, BeforeValidator(_bare), AfterValidator(_not_ours), check.KEYS]
Signal = Annotated[str, BeforeValidator(check.read_signal), Written("signal")]
Cores = Annotated[
    float,
    BeforeValidator(_cores),
    Field(allow_inf_nan=False),
    check.between((0.01, 1 << 20), what="write at least 0.01"),
    Written("number of cores", TEXT),
]
Limit = Annotated[Memory, check.between((0, 0), (LEAST_MEMORY, MOST), what="the engine takes 6Mi and more")]
Limitless = Annotated[Memory, check.between((-1, 0), (LEAST_MEMORY, MOST), what="the engine takes 6Mi and more")]
Bytes = Annotated[Memory, check.between((0, MOST), what="write an amount of memory")]


T = TypeVar("T")
Many = Annotated[list[T], BeforeValidator(one_or_many), Written("text | list of text", TEXT)]
"""A list; a single item may be written without brackets."""
