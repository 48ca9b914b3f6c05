"""How fields of manifests are declared: what each means, an example, what holds where it is left out, and what a change
of it costs. Schemas, the reference and `rorg explain` are made of these declarations."""

from __future__ import annotations

from typing import Any, NamedTuple

from pydantic import Field


class Written(NamedTuple):
    """In the annotation of a field: its type in the words of who writes a manifest."""

    text: str


def field(about: str, example: Any, default: Any = None, *, unset: str = "", change: str = "", **more: Any) -> Any:
    """A field of a manifest. A callable `default` makes it anew each time, `...` makes the field a required one.
    `unset` says what holds where it is left out, for those whose default is None."""
    marks: dict[str, Any] = {"x-rorg-change": change} if change else {}
    if unset:
        marks["x-rorg-default"] = unset
    given: dict[str, Any] = {"default_factory": default} if callable(default) else {"default": default}
    return Field(**given, description=about, examples=[example], json_schema_extra=marks, **more)


def recreate(about: str, example: Any, default: Any = None, **more: Any) -> Any:
    """A field whose change costs a new container."""
    return field(about, example, default, change="recreate", **more)


def live(about: str, example: Any, default: Any = None, **more: Any) -> Any:
    """A field that the engine changes in place."""
    return field(about, example, default, change="live", **more)


def unchanging(about: str, example: Any, default: Any = None, **more: Any) -> Any:
    """A field whose change costs a running container nothing."""
    return field(about, example, default, change="none", **more)
