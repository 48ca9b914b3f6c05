"""One effective value of a service with its source, and the manifests that may set it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from rorg.manifest.documents import Source
from rorg.manifest.field_texts import FieldText, inline, written, written_mapping
from rorg.manifest.yaml_source import Use
from rorg.model.diagnostics import Where

NOT_SHOWN = "(not shown)"


@dataclass(frozen=True)
class Value:
    """One value. `value` is plain JSON (seconds, bytes, cores), `text` as people write it."""

    field: str
    value: Any
    text: str
    kind: str
    """manifest, profile, policy, env_file or default."""
    name: str = ""
    """The name of the profile."""
    where: Where | None = None
    variables: tuple[Use, ...] = ()
    """Variables of robot.env in it."""

    @property
    def source(self) -> str:
        """The source for people."""
        head = f"{self.kind} {self.name}".strip()
        places = [f"{self.where.file}:{self.where.line}"] if self.where else []
        return ", ".join(
            [head, *places, *(f"{u.name} of {u.where.file}:{u.where.line}" for u in self.variables if u.where)]
        )

    def as_json(self) -> dict[str, Any]:
        """The value with its source in parts; null if it is not shown."""
        place = {"file": self.where.file, "line": self.where.line} if self.where else {}
        name = {"name": self.name} if self.name else {}
        used = [{"name": u.name, "file": u.where.file, "line": u.where.line} for u in self.variables if u.where]
        source = {"kind": self.kind, **name, **place, **({"variables": used} if used else {})}
        return {"field": self.field, "value": self.value, "source": source}


@dataclass(frozen=True)
class Level:
    """One manifest that sets values of the service: its own, a profile, or the Policy."""

    kind: str
    source: Source

    @property
    def name(self) -> str:
        return self.source.name if self.kind == "profile" else ""

    def value(self, field: str, told: FieldText, value: Any, *path: str | int) -> Value:
        """A value at a path of this manifest."""
        plain = [_plain(item) for item in value] if isinstance(value, list) else _plain(value)
        mapping = isinstance(plain, dict | list)
        text = inline(written_mapping(plain, told.model)) if mapping else written(plain, told.form)
        document = self.source.document
        path = written_at(document.value, path)
        used = tuple(dict.fromkeys(u for at, us in document.filled.items() if at[: len(path)] == path for u in us))
        return Value(field, plain, text, self.kind, self.name, self.source.where(*path), used)


def _plain(value: Any) -> Any:
    return value.model_dump(mode="json", exclude_unset=True) if isinstance(value, BaseModel) else value


def written_at(value: Any, path: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """The path of a value as written: pairs may be a list of KEY=VALUE."""
    for depth, key in enumerate(path):
        if isinstance(value, list) and isinstance(key, str):
            indices = (i for i, item in enumerate(value) if str(item).partition("=")[0] == key)
            return (*path[:depth], *list(indices)[-1:])
        try:
            value = value[key]
        except (LookupError, TypeError):
            break
    return path
