"""Durations, amounts of memory and names as fields of manifests."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints, WithJsonSchema

from rorg.manifest.fields import Written
from rorg.model import image_names
from rorg.model.units import DURATION, MEMORY, NAME, parse_duration, parse_memory

Duration = Annotated[
    float,
    BeforeValidator(parse_duration),
    WithJsonSchema({"anyOf": [{"type": "number", "minimum": 0}, {"type": "string", "pattern": DURATION}]}),
    Written("duration"),
]
Interval = Annotated[Duration, Field(ge=0.05)]
"""Of what is done again and again."""
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
