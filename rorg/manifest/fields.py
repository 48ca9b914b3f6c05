"""How fields of manifests are declared: meaning, example, default, and the cost of a change. The JSON schemas, the
reference pages and `rorg explain` are generated from these declarations."""

from __future__ import annotations

from typing import Any, NamedTuple

from pydantic import Field


class Written(NamedTuple):
    """An annotation: the type of a field as people read it."""

    text: str


def field(about: str, example: Any, default: Any = None, *, unset: str = "", change: str = "", **more: Any) -> Any:
    """Declares a field of a manifest. A callable `default` is called for each instance; `...` makes the field required.
    `unset` describes what applies when a field whose default is None is left out."""
    marks: dict[str, Any] = {"x-rorg-change": change} if change else {}
    if unset:
        marks["x-rorg-default"] = unset
    given: dict[str, Any] = {"default_factory": default} if callable(default) else {"default": default}
    return Field(**given, description=about, examples=[example], json_schema_extra=marks, **more)


def recreate(about: str, example: Any, default: Any = None, **more: Any) -> Any:
    """Declares a field whose change needs a new container."""
    return field(about, example, default, change="recreate", **more)


def live(about: str, example: Any, default: Any = None, **more: Any) -> Any:
    """Declares a field that the engine changes in place."""
    return field(about, example, default, change="live", **more)


def unchanging(about: str, example: Any, default: Any = None, **more: Any) -> Any:
    """Declares a field whose change does not touch a running container."""
    return field(about, example, default, change="none", **more)
