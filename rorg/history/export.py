"""Exports the history as lines of JSON or as protocol buffers. Both have the same content, except that protocol buffers
do not tell an empty list from a missing one.

The wire format is that of proto3 (protobuf.dev, "Encoding"): a stream of records, each after its length as a varint.
rorg writes it itself, because the protobuf package is larger than this file needs.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

VARINT, DOUBLE, LENGTH = 0, 1, 2
"""Wire types."""
MORE = "more"
"""The field for what has no field of its own."""


PROTO = """\
// Generated from rorg/history/export.py; do not edit.
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

// A state of the manifests that was applied or refused.
message Revision {
  optional int64 number = 1;  // 1, 2, ... as in `rorg history`.
  optional string at = 2;  // ISO 8601, UTC: when it was taken into use.
  optional string fingerprint = 3;  // Of the manifests' content.
  optional string commit = 4;  // Of git; empty outside of a repository.
  optional string author = 5;  // Of the commit.
  optional string subject = 6;  // Of the commit.
  optional bool dirty = 7;  // Files differed from the commit.
  optional string robot = 8;  // Whose overlay was laid over the manifests.
  optional string standing = 9;  // applying, baking, good, failed, superseded or refused.
  optional string reason = 10;  // Why it has that standing.
  optional string settled_at = 11;  // ISO 8601, UTC: since when.
  optional string plan = 12;  // What was to be done on its word, as text.
  repeated string errors = 13;  // Of a refused one.
  map<string, Made> services = 14;
}

// What a container of a service is made from.
message Made {
  optional string digest = 1;  // Of the rendered options.
  optional string declared = 2;  // The rendered options, as JSON; what may be secret is masked.
  optional string image = 3;  // Its reference.
  optional string image_id = 4;  // The engine's id of it, where it was known.
  optional string edition = 5;  // Of the manifest, and of what it mounts.
}

// An entry of the journal; which fields it has beyond the first four depends on its kind.
message Event {
  optional int64 seq = 1;  // Its number; they grow.
  optional string at = 2;  // ISO 8601, UTC.
  optional string kind = 3;  // A stable word.
  optional string message = 4;  // For people.
  optional string author = 5;  // Who asked for it.
  optional string service = 6;
  repeated string services = 7;
  repeated string requests = 8;  // REQUESTER/ID that it concerns.
  optional string request = 9;
  optional string cause = 10;  // A stable word.
  optional string incarnation = 11;  // The run that it is about.
  optional string verb = 12;  // Of an action: create, update, rename, signal, start, resume, pause, stop, remove.
  optional string container = 13;
  optional string reason = 14;
  repeated string fields = 15;  // Declared options that changed.
  optional string error = 16;  // Empty where it went well.
  optional double seconds = 17;  // How long it took.
  optional string file = 18;
  optional int64 crashes = 19;
  optional string node = 20;  // Of a ROS node.
  optional int64 bytes = 21;  // Of memory that was given back.
  repeated string measures = 22;  // Against pressure, that are in force.
  optional bool helpless = 23;  // Nothing that rorg runs would help.
  map<string, string> shed = 24;  // Services that had to make room, each with the reason.
  map<string, string> states = 25;  // Services, and the states that they were found in.
  optional string state = 26;  // That a service has come into; `none` without a container.
  repeated string requested = 27;  // Services and groups that a request names.
  optional string more = 100;  // What has no field of its own here, as JSON.
}
"""
"""The schema, which schemas/journal.proto has a copy of. A number is never given to another field."""
FIELD = re.compile(r"^ +(?:optional )?((?:repeated )?[\w<>, ]+?) (\w+) = (\d+);", re.M)


class Field(NamedTuple):
    """A field of a message; `type` as in the schema, without `optional`."""

    number: int
    name: str
    type: str


class Message(NamedTuple):
    """A message of the schema."""

    name: str
    fields: tuple[Field, ...]


MESSAGES = {
    name: Message(name, tuple(Field(int(number), field, type) for type, field, number in FIELD.findall(body)))
    for name, body in re.findall(r"^message (\w+) {\n(.*?)^}", PROTO, re.M | re.S)
}
RECORD, REVISION, MADE, EVENT = (MESSAGES[name] for name in ("Record", "Revision", "Made", "Event"))


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
    found = bytearray()
    while number > 127:
        found.append(number & 127 | 128)
        number >>= 7
    return bytes([*found, number])


def line(value: Mapping[str, Any]) -> bytes:
    """Encode a record as a line of JSON."""
    return json.dumps(value).encode() + b"\n"


ENCODERS: Mapping[str, Callable[[Mapping[str, Any]], bytes]] = {"jsonl": line, "protobuf": record}
"""Encoders by the name of the format."""


if __name__ == "__main__":
    import sys
    from pathlib import Path

    Path(sys.argv[1]).write_text(PROTO)
