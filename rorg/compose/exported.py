"""What comes of writing a robot as a Compose file: the document, what stands beside it, and what is not in it."""

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
    """Empty for what is said of the whole robot."""
    field: str
    """Of the manifest: `spec.idle`, `spec.container.cpuset_mems`."""
    text: str
    """What becomes of it."""
    lost: bool = True
    """It is not in the Compose file at all; False where other words stand for it."""

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        carried = "not carried" if self.lost else "translated"
        return {"service": self.service, "field": self.field, "carried": carried, "message": self.text}

    def __str__(self) -> str:
        return f"{self.field}: {self.text}"


@dataclass(frozen=True, slots=True)
class Exported:
    """A robot as a Compose file."""

    document: Mapping[str, Any]
    """As Compose takes it, but for `$` in texts, which stands once."""
    notes: tuple[Note, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    """Name -> text of what the document names beside it. Those that end in .env hold secrets."""
    descriptions: Mapping[str, str] = field(default_factory=dict)
    """Service -> its description."""


_PLAIN = re.compile(r"[A-Za-z_/.][A-Za-z0-9_/.@=+-]*( [A-Za-z_/][A-Za-z0-9_/.@=+-]*)*")
"""What no version of YAML takes for anything but a text; other texts are quoted."""
_WORDS = re.compile(r"(?i:y|n|yes|no|on|off|true|false|null|\.?inf|\.?nan)")


class _Dumper(yaml.SafeDumper):
    """YAML that means the same by 1.1 and by 1.2, which readers of Compose files mix."""

    def ignore_aliases(self, _data: Any) -> bool:
        """Each value is written out where it stands."""
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
    """The same with each `$` of its texts doubled: Compose fills in variables where one stands alone."""
    if isinstance(value, str):
        return value.replace("$", "$$")
    if isinstance(value, Mapping):
        return {key: escaped(item) for key, item in value.items()}
    return [escaped(item) for item in value] if isinstance(value, list | tuple) else value


def write(exported: Exported) -> str:
    """A whole Compose file, with what it cannot say as comments where it would stand."""
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
    head = ["Written by `rorg export compose`."] + ([f"What is {what} and not in this file:"] if lines else [])
    return "".join(f"# {line}\n" for line in head + lines)


def _lines(text: str, indent: int) -> str:
    return "".join(f"{' ' * indent}# {line}\n" for line in text.splitlines())
