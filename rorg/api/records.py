"""Encodes the records of an export as lines of JSON or as protocol buffers. Both have the same content, except that
protocol buffers do not tell an empty list from a missing one.

The wire format is that of proto3 (protobuf.dev, "Encoding"): a stream of records, each after its length as a varint.
rorg writes it itself, because the protobuf package is larger than this file needs. The schema is made from the models
of the API: `python -m rorg.api.records FILE`.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator, Mapping
from types import NoneType
from typing import Any, NamedTuple, get_args, get_origin

from pydantic import BaseModel

from rorg.api.history_models import MadeView, RevisionDetail
from rorg.api.status_models import EventView

VARINT, DOUBLE, LENGTH = 0, 1, 2
"""Wire types."""
MORE = "more"
"""The field for what has no field of its own."""
HEAD = """\
// Generated from rorg/api/records.py; do not edit.
// What `rorg history export --format protobuf` writes: Records, each after its length as a varint.
syntax = "proto3";

package rorg.history.v1;

// One of the stream: it has one of these. Revisions come first, each kind in the order of its numbers.
message Record {
  oneof what {
    Revision revision = 1;
    Event event = 2;
  }
}
"""
TYPES: dict[Any, str] = {str: "string", bool: "bool", int: "int64", float: "double", MadeView: "Made"}
"""Annotations of models, and the types of the schema."""


class Field(NamedTuple):
    """A field of a message; `type` as in the schema, without `optional`."""

    number: int
    name: str
    type: str
    comment: str = ""

    def __str__(self) -> str:
        label = "" if self.type.startswith(("repeated ", "map<")) else "optional "
        return f"  {label}{self.type} {self.name} = {self.number};" + (f"  // {self.comment}" if self.comment else "")


class Message(NamedTuple):
    """A message of the schema."""

    name: str
    fields: tuple[Field, ...]
    comment: str = ""

    def __str__(self) -> str:
        return "\n".join([f"\n// {self.comment}", f"message {self.name} {{", *map(str, self.fields), "}\n"])


def _message(name: str, model: type[BaseModel], names: str, *more: Field) -> Message:
    """The message of a model. `names`: its fields in the order of their numbers. A number is never given to another
    field: append, and neither reorder nor remove."""
    infos = enumerate(((field, model.model_fields[field]) for field in names.split()), 1)
    fields = (Field(n, field, _type(info.annotation), info.description or "") for n, (field, info) in infos)
    return Message(name, (*fields, *more), model.__doc__ or "")


def _type(annotation: Any) -> str:
    """The type of a field, without None."""
    parts = [part for part in get_args(annotation) if part is not NoneType]
    if get_origin(annotation) is list:
        return f"repeated {_type(parts[0])}"
    if get_origin(annotation) is dict:
        return f"map<{', '.join(map(_type, parts))}>"
    return TYPES[annotation] if annotation in TYPES else _type(parts[0])


RECORD = Message("Record", (Field(1, "revision", "Revision"), Field(2, "event", "Event")))
REVISION = _message(
    "Revision",
    RevisionDetail,
    "number at fingerprint commit author subject dirty robot standing reason settled_at plan errors services proven_at",
)
MADE = _message("Made", MadeView, "digest declared image image_id edition")
EVENT = _message(
    "Event",
    EventView,
    "seq at kind message author service services requests request cause incarnation verb container reason fields error "
    "seconds file crashes node bytes measures helpless shed states state requested revision failed",
    Field(100, MORE, "string", "Everything that has no field of its own here, as JSON."),
)
MESSAGES = {message.name: message for message in (RECORD, REVISION, MADE, EVENT)}


def schema() -> str:
    """The schema, of which schemas/journal.proto is a copy."""
    return HEAD + "".join(map(str, (REVISION, MADE, EVENT)))


def record(value: Mapping[str, Any]) -> bytes:
    """Encode a record ({"revision": ...} or {"event": ...}), after its length."""
    body = encoded(RECORD, value)
    return _varint(len(body)) + body


def encoded(message: Message, value: Mapping[str, Any]) -> bytes:
    """Encode a value as a message. None is left out; what has no fitting field goes into `more` if the message has
    that."""
    fields = {field.name: field for field in message.fields}
    own = {name: item for name, item in value.items() if name in fields and _fits(fields[name].type, item)}
    rest = {name: item for name, item in value.items() if name not in own and item is not None}
    if rest and MORE in fields:
        own[MORE] = json.dumps(rest)
    return b"".join(piece for name, item in own.items() for piece in _pieces(fields[name], item))


def _fits(type: str, value: Any) -> bool:
    kind, _, of = type.partition(" ")
    if kind == "repeated":
        return isinstance(value, list | tuple) and all(_fits(of, item) for item in value)
    if kind.startswith("map<"):
        return isinstance(value, Mapping) and all(isinstance(k, str) and _fits(of[:-1], v) for k, v in value.items())
    if kind == "int64":
        return isinstance(value, int) and not isinstance(value, bool) and -(1 << 63) <= value < 1 << 63
    if kind == "double":
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, {"string": str, "bool": bool}.get(kind, Mapping))


def _pieces(field: Field, value: Any) -> Iterator[bytes]:
    kind, _, of = field.type.partition(" ")
    if kind == "repeated":
        for item in value:
            yield from _pieces(field._replace(type=of), item)
    elif kind.startswith("map<"):  # a repeated message of key (1) and value (2)
        for key, item in value.items():
            pair = [*_pieces(Field(1, "", "string"), key), *_pieces(Field(2, "", of[:-1]), item)]
            yield _lengthy(field.number, b"".join(pair))
    elif kind in ("int64", "bool"):
        yield _tag(field.number, VARINT) + _varint(int(value) & (1 << 64) - 1)
    elif kind == "double":
        yield _tag(field.number, DOUBLE) + struct.pack("<d", value)
    elif kind == "string":
        yield _lengthy(field.number, value.encode("utf-8", errors="backslashreplace"))
    else:
        yield _lengthy(field.number, encoded(MESSAGES[kind], value))


def _lengthy(number: int, body: bytes) -> bytes:
    return _tag(number, LENGTH) + _varint(len(body)) + body


def _tag(number: int, wire: int) -> bytes:
    return _varint(number << 3 | wire)


def _varint(number: int) -> bytes:
    """Seven bits in each byte, the lowest first; the eighth bit says that another byte follows."""
    buffer = bytearray()
    while number > 127:
        buffer.append(number & 127 | 128)
        number >>= 7
    return bytes([*buffer, number])


def line(value: Mapping[str, Any]) -> bytes:
    """Encode a record as a line of JSON."""
    return json.dumps(value).encode() + b"\n"


ENCODERS: Mapping[str, Callable[[Mapping[str, Any]], bytes]] = {"jsonl": line, "protobuf": record}
"""Encoders by the name of the format."""


if __name__ == "__main__":
    import sys
    from pathlib import Path

    Path(sys.argv[1]).write_text(schema())
