"""Reads files that hold a single document outside a tree, in the envelope of manifests: traces and workloads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from rorg.errors import Invalid
from rorg.manifest.model_errors import validated
from rorg.manifest.models import Manifest
from rorg.manifest.option_forms import Strict
from rorg.manifest.yaml_source import Document, read_yaml
from rorg.model.diagnostics import Diagnostic, Reading, collected
from rorg.model.units import counted

S = TypeVar("S", bound=Strict)
V = TypeVar("V")
LARGEST = 64 << 20
"""Bytes."""


@dataclass(frozen=True, slots=True)
class OneDocument(Generic[S]):
    """A valid document: the YAML for positions, the spec for content."""

    document: Document
    name: str
    description: str
    spec: S


def read_document(path: Path, kind: str, model: type[S], make: Callable[[OneDocument[S]], Reading[V]]) -> V:
    """Reads a document of this kind and converts it with `make`. Raises Invalid with everything that is wrong."""
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
        text = raw.decode("utf-8")
    except UnicodeDecodeError:
        raise Invalid(f"read {path}", "it is not UTF-8 text", f"a file with a {kind}") from None
    except OSError as error:
        raise Invalid(f"read {path}", error.strerror or str(error), f"a file with a {kind}") from None
    if len(raw) > LARGEST:
        raise Invalid(f"read {path}", f"it has more than {LARGEST >> 20} MiB", f"a smaller {kind}")
    document, diagnostics = read_yaml(text, str(path), most=MOST_NODES)
    if document is not None and not diagnostics:
        checked, diagnostics = collected(_checked(document, kind, model))
        if checked is not None:
            value, diagnostics = collected(make(checked))
            if not diagnostics:
                return value
    lines = "\n".join(map(str, diagnostics))
    raise Invalid(
        f"use {path}", f"{counted(len(diagnostics), 'error')}\n{lines}\n", f"to fix what is wrong in this {kind}"
    )


MOST_NODES = 5_000_000
"""YAML values in a file; a trace of one day has some hundred thousand."""


def _checked(document: Document, kind: str, model: type[S]) -> Reading[OneDocument[S] | None]:
    value = document.value
    if not isinstance(value, dict):
        yield Diagnostic(document.where(()), f"a {kind} must be a mapping with apiVersion, kind, metadata, spec")
        return None
    if value.get("kind") != kind:
        yield Diagnostic(document.where(("kind",)), f"the kind must be {kind}", f"'{kind}'")
        return None
    envelope, diagnostics = validated(Manifest, document, value, ())
    spec, more = validated(model, document, value.get("spec"), ("spec",))
    yield from (*diagnostics, *more)
    if envelope is None or spec is None:
        return None
    return OneDocument(document, envelope.metadata.name, envelope.metadata.description or "", spec)
