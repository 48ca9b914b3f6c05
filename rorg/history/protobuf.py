"""The export as protocol buffers: one table says which fields there are, by what numbers; `schemas/journal.proto` is
written from it, and records are encoded by it. The wire format is that of proto3 (protobuf.dev, "Encoding"): a stream
of records, each after its length as a varint."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

VARINT, DOUBLE, LENGTH = 0, 1, 2
"""Wire types."""
MORE = "more"
"""The field for what has none of its own."""


class Field(NamedTuple):
    """`type` as in a .proto; `about` becomes its comment. A number is never given to another field."""

    number: int
    name: str
    type: str
    about: str = ""


class Message(NamedTuple):
    """A message of the schema."""

    name: str
    about: str
    fields: tuple[Field, ...]


MADE = Message(
    "Made",
    "What a container of a service is made from.",
    (
        Field(1, "digest", "string", "Of the rendered options."),
        Field(2, "declared", "string", "The rendered options, as JSON; what may be secret is masked."),
        Field(3, "image", "string", "Its reference."),
        Field(4, "image_id", "string", "The engine's id of it, where it was known."),
        Field(5, "edition", "string", "Of the manifest, and of what it mounts."),
    ),
)
REVISION = Message(
    "Revision",
    "A state of the manifests that was applied or refused.",
    (
        Field(1, "number", "int64", "1, 2, ... as in `rorg history`."),
        Field(2, "at", "string", "ISO 8601, UTC: when it was taken into use."),
        Field(3, "fingerprint", "string", "Of the manifests' content."),
        Field(4, "commit", "string", "Of git; empty outside of a repository."),
        Field(5, "author", "string", "Of the commit."),
        Field(6, "subject", "string", "Of the commit."),
        Field(7, "dirty", "bool", "Files differed from the commit."),
        Field(8, "robot", "string", "Whose overlay was laid over the manifests."),
        Field(9, "standing", "string", "applying, baking, good, failed, superseded or refused."),
        Field(10, "reason", "string", "Why it has that standing."),
        Field(11, "settled_at", "string", "ISO 8601, UTC: since when."),
        Field(12, "plan", "string", "What was to be done on its word, as text."),
        Field(13, "errors", "repeated string", "Of a refused one."),
        Field(14, "services", "map<string, Made>"),
    ),
)
EVENT = Message(
    "Event",
    "An entry of the journal; which fields it has beyond the first four depends on its kind.",
    (
        Field(1, "seq", "int64", "Its number; they grow."),
        Field(2, "at", "string", "ISO 8601, UTC."),
        Field(3, "kind", "string", "A stable word."),
        Field(4, "message", "string", "For people."),
        Field(5, "author", "string", "Who asked for it."),
        Field(6, "service", "string"),
        Field(7, "services", "repeated string"),
        Field(8, "requests", "repeated string", "REQUESTER/ID that it concerns."),
        Field(9, "request", "string"),
        Field(10, "cause", "string", "A stable word."),
        Field(11, "incarnation", "string", "The run that it is about."),
        Field(
            12, "verb", "string", "Of an action: create, update, rename, signal, start, resume, pause, stop, remove."
        ),
        Field(13, "container", "string"),
        Field(14, "reason", "string"),
        Field(15, "fields", "repeated string", "Declared options that changed."),
        Field(16, "error", "string", "Empty where it went well."),
        Field(17, "seconds", "double", "How long it took."),
        Field(18, "file", "string"),
        Field(19, "crashes", "int64"),
        Field(20, "node", "string", "Of a ROS node."),
        Field(21, "bytes", "int64", "Of memory that was given back."),
        Field(22, "measures", "repeated string", "Against pressure, that are in force."),
        Field(23, "helpless", "bool", "Nothing that rorg runs would help."),
        Field(24, "shed", "map<string, string>", "Services that had to make room, each with the reason."),
        Field(25, "states", "map<string, string>", "Services, and the states that they were found in."),
        Field(26, "state", "string", "That a service has come into; `none` without a container."),
        Field(27, "requested", "repeated string", "Services and groups that a request names."),
        Field(100, MORE, "string", "What has no field of its own here, as JSON."),
    ),
)
RECORD = Message(
    "Record",
    "One of the stream: it has one of these. Revisions come first, each kind in the order of its numbers.",
    (Field(1, "revision", "Revision"), Field(2, "event", "Event")),
)
MESSAGES = {message.name: message for message in (RECORD, REVISION, MADE, EVENT)}


def record(value: Mapping[str, Any]) -> bytes:
    """A record ({"revision": ...} or {"event": ...}) as it stands in the stream, after its length."""
    body = encoded(RECORD, value)
    return _varint(len(body)) + body


def encoded(message: Message, value: Mapping[str, Any]) -> bytes:
    """A value as a message. What is None is left out; what the message has no fitting field for goes into `more` where
    it has that one."""
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
    """Seven bits a byte, the lowest first; the eighth says that another byte follows."""
    found = bytearray()
    while number > 127:
        found.append(number & 127 | 128)
        number >>= 7
    return bytes([*found, number])


def proto() -> str:
    """The schema as a .proto."""
    head = (
        "// Generated from rorg/history/protobuf.py; do not edit.\n"
        "// What `rorg history export --format protobuf` writes: Records, each after its length as a varint.\n"
        'syntax = "proto3";\n\npackage rorg.history.v1;\n'
    )
    return head + "".join(_message(message) for message in MESSAGES.values())


def _message(message: Message) -> str:
    lines = [f"\n// {message.about}", f"message {message.name} {{"]
    inner = "  "
    if message is RECORD:
        lines.append("  oneof what {")
        inner = "    "
    for field in message.fields:
        scalar = message is not RECORD and " " not in field.type
        comment = f"  // {field.about}" if field.about else ""
        lines.append(f"{inner}{'optional ' * scalar}{field.type} {field.name} = {field.number};{comment}")
    return "\n".join([*lines, *["  }"] * (message is RECORD), "}", ""])


if __name__ == "__main__":
    import sys
    from pathlib import Path

    Path(sys.argv[1]).write_text(proto())
