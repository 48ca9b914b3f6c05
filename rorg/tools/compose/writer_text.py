"""A robot as a Compose file: the document, the files beside it, notes on what it does not say, and its text."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import yaml


@dataclass(frozen=True, slots=True)
class Note:
    """Something that a Compose file cannot say, or says in other words."""

    service: str
    """Empty for the whole robot."""
    field: str
    """In the manifest: `spec.idle`, `spec.container.cpuset_mems`."""
    text: str
    """What becomes of it."""
    lost: bool = True
    """Whether the Compose file does not have it at all; False if the file says it in other words."""

    def as_json(self) -> dict[str, Any]:
        """The note as a JSON object."""
        carried = "not carried" if self.lost else "translated"
        return {"service": self.service, "field": self.field, "carried": carried, "message": self.text}

    def __str__(self) -> str:
        return f"{self.field}: {self.text}"


@dataclass(frozen=True, slots=True)
class Exported:
    """A robot as a Compose file."""

    document: Mapping[str, Any]
    """The document in the form of Compose, except that `$` is not doubled yet."""
    notes: tuple[Note, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    """Name -> text of files beside the document that it refers to. Those that end in .env hold secrets."""
    descriptions: Mapping[str, str] = field(default_factory=dict)
    """Service -> its description."""


_PLAIN = re.compile(r"[A-Za-z_/.][A-Za-z0-9_/.@=+-]*( [A-Za-z_/][A-Za-z0-9_/.@=+-]*)*")
"""Texts that every version of YAML reads as text; all other texts are quoted."""
_WORDS = re.compile(r"(?i:y|n|yes|no|on|off|true|false|null|\.?inf|\.?nan)")


class _Dumper(yaml.SafeDumper):
    """Writes YAML that means the same in 1.1 and 1.2, because readers of Compose files mix the two."""

    def ignore_aliases(self, _data: Any) -> bool:
        """Writes out every value, without aliases."""
        return True


def _text(dumper: _Dumper, value: str) -> yaml.ScalarNode:
    if _PLAIN.fullmatch(value) and not _WORDS.fullmatch(value) and not re.match(r"\.+[0-9]|\.$", value):
        style = None
    else:
        style = "'" if value.isprintable() else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style)


def _nothing(dumper: _Dumper, _value: None) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:null", "null")


_Dumper.add_representer(str, _text)
_Dumper.add_representer(type(None), _nothing)


def escaped(value: Any) -> Any:
    """The same value with each `$` doubled, because Compose fills in variables after a single one."""
    if isinstance(value, str):
        return value.replace("$", "$$")
    if isinstance(value, Mapping):
        return {key: escaped(item) for key, item in value.items()}
    return [escaped(item) for item in value] if isinstance(value, list | tuple) else value


def write(exported: Exported) -> str:
    """The text of a whole Compose file. Comments say what it cannot express."""
    document = escaped(exported.document)
    notes = exported.notes
    parts = [_comments("of this robot", (n for n in notes if not n.service)), _yaml({"name": document["name"]}, 0)]
    parts.append("services:\n" if document["services"] else "services: {}\n")
    for name, section in document["services"].items():
        head = f"{name}:" if _PLAIN.fullmatch(name) else _yaml({name: 0}, 0).rpartition(" ")[0]
        own = [_lines(exported.descriptions.get(name, ""), 2), f"  {head}\n"]
        own += ["".join(f"    # {line}\n" for n in notes if n.service == name for line in _said(n))]
        parts.append("".join(own) + _yaml(section, 4))
    parts += [_yaml({key: document[key]}, 0) for key in ("networks", "volumes") if key in document]
    return "".join(parts)


def _yaml(value: Any, indent: int) -> str:
    text = yaml.dump(value, Dumper=_Dumper, sort_keys=False, width=4096, allow_unicode=True, default_flow_style=False)
    return "".join(f"{' ' * indent}{line}\n" for line in text.rstrip("\n").split("\n"))


def _said(note: Note) -> list[str]:
    return f"{'not carried' if note.lost else 'note'}: {note}".splitlines()


def _comments(what: str, notes: Iterable[Note]) -> str:
    lines = [line for note in notes for line in _said(note)]
    head = ["Written by `rorg export compose`."] + ([f"Parts {what} that are not in this file:"] if lines else [])
    return "".join(f"# {line}\n" for line in head + lines)


def _lines(text: str, indent: int) -> str:
    return "".join(f"{' ' * indent}# {line}\n" for line in text.splitlines())
