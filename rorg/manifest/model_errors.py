"""Translates pydantic's errors into diagnostics with a place in the file and in the words of manifests."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel, ValidationError

from rorg.manifest.dropped import Shift, without, without_items
from rorg.manifest.fields import model_of
from rorg.manifest.hints import remedy_for
from rorg.manifest.models import API_VERSION
from rorg.manifest.option_checks import PARTIAL
from rorg.manifest.option_forms import NotTextError, Strict
from rorg.manifest.yaml_source import Document, as_scalar
from rorg.manifest.yaml_source import Path as Loc
from rorg.manifest.yaml_text import scalar
from rorg.model.diagnostics import Diagnostic, Where


def validated(model: type[Strict], document: Document, value: object, at: Loc) -> tuple[Any, list[Diagnostic]]:
    """Validates a value; returns None with all mistakes if it is invalid. `at` is the path of the value. If a variable
    was filled into a text and the field needs a number or a boolean, the text is converted as YAML would read it."""
    try:
        return model.model_validate(value), []
    except ValidationError as error:
        again = _converted(value, document, error, at)
    try:
        return model.model_validate(again), []
    except ValidationError as error:
        by_place: dict[tuple[Where, str], Diagnostic] = {}
        for entry in error.errors(include_url=False):
            diagnostic = _explain(model, document, entry, at)
            # A union reports once per member; the first report is enough.
            by_place.setdefault(
                (diagnostic.where, diagnostic.message if entry["type"] == "missing" else ""), diagnostic
            )
        return None, list(by_place.values())


BOOLEANS = {"yes": "true", "on": "true", "y": "true", "no": "false", "off": "false", "n": "false"}
"""Booleans of YAML 1.1, which are texts in YAML 1.2."""


WANTED = {"list_type": "list", "string_type": "text"}
"""Error of pydantic -> what the value should be."""
TYPES: dict[str, type | tuple[type, ...]] = {
    "boolean": bool,
    "number": (int, float),
    "text": str,
    "list": list,
    "mapping": dict,
}
"""What a value is -> its types; a boolean of Python is also a number."""
LONGEST = 60
"""Characters of a value in a message."""


TRIES = 5
"""Rounds of dropping mistakes; a validator of a mapping runs only after those of its values."""


def mended(
    model: type[Strict], document: Document, value: object, at: Loc, wrong: Iterable[Diagnostic]
) -> tuple[Any, Document, list[Diagnostic]]:
    """Validates an invalid value again without its mistakes, so that what is left can be checked too; returns None if
    too little is left. Also returns the document without dropped items of lists, and the mistakes that only show
    then. `wrong` are the mistakes that are known."""
    dropped, doubtful = set[Loc](), set[Loc]()
    known, more, context = {d.where for d in wrong}, list[Diagnostic](), None
    for _ in range(TRIES):
        try:
            return model.model_validate(value, context=context), document, more
        except ValidationError as error:
            again = _converted(value, document, error, at)
            entries = error.errors(include_url=False)
        if again is not value:
            value = again
            continue
        explained = {_droppable(document, at, entry): _explain(model, document, entry, at) for entry in entries}
        new = [d for place, d in explained.items() if d.where not in known and place not in doubtful]
        known.update(d.where for d in new)
        more += new
        if explained.keys() <= dropped | {at}:
            if context:
                break
            context = PARTIAL
        gone = explained.keys() - dropped - {at}
        doubtful |= {place[:-1] for place in gone if not _meant_elsewhere(explained[place], place[:-1] == at)}
        value = without(value, [place[len(at) :] for place in gone])
        document = without_items(document, [place for place in gone if isinstance(place[-1], int)])
        shift = Shift.of(gone)
        dropped, doubtful = shift.paths(dropped | gone), shift.paths(doubtful)
    return None, document, more


def _meant_elsewhere(diagnostic: Diagnostic, at_top: bool) -> bool:
    """Whether a dropped key belongs into another mapping. Otherwise its own may lack what the key was meant to be."""
    elsewhere = diagnostic.remedy.startswith(("spec.", "metadata.")) or (not diagnostic.remedy and at_top)
    return elsewhere and diagnostic.message.startswith("unknown key")


def _droppable(document: Document, at: Loc, entry: Any) -> Loc:
    """The key or the item of a list to drop: the mistaken one, or the one above a missing key. An item is dropped as a
    whole, because without one of its keys it may mean something else."""
    place = _place(document, at + tuple(entry["loc"]))
    place = place[:-1] if entry["type"] == "missing" else place
    index = next((i + 1 for i, part in enumerate(place) if isinstance(part, int)), len(place))
    while index > len(at) and place[:index] not in document.values:
        index -= 1
    return place[:index]


def _converted(value: object, document: Document, error: ValidationError, at: Loc) -> object:
    """Converts the refused texts that variables were filled into."""
    places = {_place(document, at + tuple(entry["loc"])) for entry in error.errors(include_url=False)}
    for place in places & document.filled.keys():
        value = _put(value, place[len(at) :])
    return value


def _put(value: Any, path: Loc) -> Any:
    """A copy in which the text at a path is the scalar that YAML reads there."""
    if not path:
        return as_scalar(value) if isinstance(value, str) else value
    copy = value.copy()
    copy[path[0]] = _put(value[path[0]], path[1:])
    return copy


def _explain(model: type[Strict], document: Document, entry: Any, at: Loc) -> Diagnostic:
    """Converts one of pydantic's errors."""
    loc = _place(document, at + tuple(entry["loc"]))
    if entry["type"] == "extra_forbidden":
        return _unknown_key(model, document, loc, at)
    if entry["type"] == "missing":
        return Diagnostic(document.where(loc[:-1], key=True), f"'{loc[-1]}' is missing")
    where = document.where(loc)
    if loc == ("spec",) and entry["input"] is None:
        return Diagnostic(where, "spec: it is empty", "to fill it, or delete the file", code="empty-document")
    if loc == ("apiVersion",):
        return Diagnostic(where, f"apiVersion must be {API_VERSION}", f"'{API_VERSION}'")
    text = entry["msg"].removeprefix("Value error, ")
    remedy = ""
    if entry["type"] == "bool_type" and str(entry["input"]).lower() in BOOLEANS:
        remedy = BOOLEANS[str(entry["input"]).lower()]
        text = f"'{entry['input']}' is a text, not true or false"
    raised = isinstance(entry.get("ctx", {}).get("error"), NotTextError)
    if wanted := "text" if raised else WANTED.get(entry["type"]):
        text, remedy = _other_type(entry["input"], wanted)
    if entry["type"] == "string_pattern_mismatch" and document.values.get(loc):
        text = f"{entry['input']!r} is not allowed here; it must match {entry['ctx']['pattern']}"
    if entry["type"] == "model_type" or entry["type"] == "dict_type":
        text = "must be a mapping"
    name = ".".join(str(part) for part in loc if document.values.get(loc[: loc.index(part) + 1])) or "manifest"
    return Diagnostic(where, f"{name}: {text[0].lower() + text[1:]}", remedy)


def _other_type(value: object, wanted: str) -> tuple[str, str]:
    """What is wrong with a value of another type, and how it may be written. A list of one text, and quotes around what
    YAML reads as a number or a boolean, are sure to be meant."""
    if value is None:
        return f"a {wanted} is missing", ""
    kind = next((name for name, types in TYPES.items() if isinstance(value, types)), "value")
    if kind in ("list", "mapping", "value"):
        return f"it is a {kind}, not a {wanted}", ""
    written = scalar(value)
    shown = "it" if len(written) > LONGEST else written if written.startswith('"') else f"'{written}'"
    if wanted == "text":
        return f"{shown} is a {kind}, not a text", "quotes around it"
    item = written if kind == "text" else scalar(written)
    return f"{shown} is a {kind}, not a list", "brackets around it" if shown == "it" else f"[{item}]"


def _place(document: Document, loc: Loc) -> Loc:
    """Removes the names that pydantic inserts for members of a union."""
    path: Loc = ()
    for index, part in enumerate(loc):
        if (*path, part) in document.values or index == len(loc) - 1 or (*path, loc[index + 1]) not in document.values:
            path = (*path, part)
    return path


def _unknown_key(model: type[Strict], document: Document, loc: Loc, at: Loc) -> Diagnostic:
    where, key = document.where(loc, key=True), str(loc[-1])
    written = document.value.get("kind")
    kind = written if isinstance(written, str) else ""
    parent = _model_at(model, loc[len(at) : -1])
    path = tuple(str(part) for part in loc[:-1])
    present: Any = document.value
    for part in loc[:-1]:
        present = present[part]
    return Diagnostic(where, f"unknown key '{key}'", remedy_for(kind, path, key, parent, present))


def _model_at(model: type[BaseModel], path: Loc) -> type[BaseModel] | None:
    """The model that a path of keys leads to, through lists and keys of the user's own."""
    for part in path:
        field = model.model_fields.get(str(part))
        target = model_of(field.annotation) if field else model
        if target is None:
            return None
        model = target
    return model
