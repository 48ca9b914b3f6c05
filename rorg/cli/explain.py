"""rorg explain"""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rorg.cli.names import complete_fields_and_services
from rorg.cli.options import Output, TreeAlone
from rorg.cli.output import dump, echo, missing, table
from rorg.errors import Invalid

if TYPE_CHECKING:
    from pathlib import Path

    from rorg.manifest.field_paths import Place
    from rorg.manifest.field_texts import FieldText

CHANGES = {
    "live": "is made in place",
    "recreate": "costs a new container",
    "none": "costs a running container nothing",
}


def command(
    context: TreeAlone,
    what: Annotated[
        str,
        typer.Argument(
            help="A field, such as service.idle.linger, or a service; services/NAME if a field has the same name.",
            autocompletion=complete_fields_and_services,
        ),
    ],
    output: Output = "table",
) -> None:
    """Explain a manifest field: meaning, type, default, example. Or explain a service: every effective value, with
    the manifest, profile, policy or default that sets it.

    Example: rorg explain service.spec.idle.linger
    """
    from rorg.manifest.field_paths import find

    kind, slash, name = what.rpartition("/")
    place = None if slash else find(what)
    if place:
        page = place.path if output == "name" else _page(place)
        dump(_as_json(place), output) if output in ("json", "yaml") else echo(page)
        return
    values = _service(context, what, kind, name)
    if output == "name":
        echo("\n".join(value.field for value in values))
        return
    if output in ("json", "yaml"):
        dump({"service": name, "values": [value.as_json() for value in values]}, output)
        return
    echo(table([{"field": v.field, "value": v.text, "source": v.source} for v in values], ("field", "value", "source")))


def _service(context: Any, what: str, kind: str, name: str) -> list[Any]:
    """All effective values of a service. Raises Invalid for an unknown name, with the nearest one."""
    from rorg.manifest.effective import effective

    if kind not in ("", "services", "service"):
        raise Invalid(f"explain '{what}'", "only services have effective values", "services/NAME")
    try:
        catalog = context.catalog()
    except Invalid:
        names = _names(context.root)
        if kind or what in names or (context.directory and not names):
            raise
        raise _unknown(what, names or None) from None
    if name in catalog.services:
        return effective(context.root, name, context.robot)
    if name in catalog.groups:
        raise Invalid(f"explain '{name}'", "it is a group", f"one of {', '.join(catalog.groups[name].services)}")
    raise missing("service", name, catalog.services) if kind else _unknown(what, catalog.services)


def _names(root: Path) -> set[str]:
    """Names that may be services of manifests with mistakes."""
    from rorg.api.manifest_texts import manifests_of
    from rorg.manifest.documents import manifest_files

    declared = {name for kind, name in manifests_of(root) if kind in ("Service", "Group")}
    return declared | {path.stem for path in manifest_files(root)}


def _unknown(what: str, services: Any) -> Invalid:
    """The error for a name that is neither; `services` is None without manifests."""
    import difflib

    from rorg.manifest.field_paths import nearest_path

    near = [nearest_path(what), *difflib.get_close_matches(what, services or (), 1)]
    likely = next(filter(None, near if "." in what else reversed(near)), "")
    if services is None:
        why = "no field of that name, and no manifests with a service of that name"
        return Invalid(f"explain '{what}'", why, likely or "to name the directory of manifests after it")
    return Invalid(f"explain '{what}'", "no field or service of that name", likely or "rorg get")


def _page(place: Place) -> str:
    """The page about a field or a kind, for people."""
    explanation, width = _as_json(place), 100
    rows = [("FIELD" if place.field else "KIND", place.path)]
    if place.field:
        default = "none, it is required" if place.field.required else explanation["default"]
        rows += [("TYPE", explanation["type"]), ("DEFAULT", default)]
        rows += [("CHANGE", CHANGES[place.field.change])] if place.field.change else []
    lines = [f"{head:<8} {text}" for head, text in rows]
    lines += [
        "",
        *textwrap.wrap(explanation["description"], width),
        "",
        "EXAMPLE",
        textwrap.indent(_example(place), "  "),
    ]
    if "fields" in explanation:
        lines += ["", "FIELDS"]
        for name, field in explanation["fields"].items():
            default = {"not set": "", "required": ", required"}.get(field["default"], f"; default: {field['default']}")
            lines.append(f"  {name}  ({field['type']}{default})")
            lines += textwrap.wrap(field["description"], width, initial_indent="      ", subsequent_indent="      ")
    return "\n".join(lines)


def _example(place: Place) -> str:
    import yaml

    name = place.path.rpartition(".")[2]
    value = {name: place.field.example} if place.field else _manifest(place)
    text: str = yaml.safe_dump(value, sort_keys=False, allow_unicode=True, width=10_000)
    return text.rstrip()


def _manifest(place: Place) -> dict[str, Any]:
    """A whole manifest of a kind."""
    from rorg.manifest.models import API_VERSION, EXAMPLES

    kind = place.path.partition(".")[0].capitalize()
    names = {"Group": "driving", "Profile": "robot", "Policy": "policy", "Request": "tour"}
    name = {**names, "Network": "ros", "Volume": "maps"}.get(kind, "navigation")
    return {"apiVersion": API_VERSION, "kind": kind, "metadata": {"name": name}, "spec": EXAMPLES[kind]}


def _as_json(place: Place) -> dict[str, Any]:
    from rorg.manifest.field_texts import about, fields_of

    explanation: dict[str, Any] = {"field": place.path}
    if place.field:
        explanation |= _told(place.field)
    else:
        explanation |= {
            "description": " ".join(about(place.model).split()) if place.model else "",
            "example": _manifest(place),
        }
    if place.model:
        explanation["fields"] = {name: _told(field) for name, field in fields_of(place.model).items()}
    return explanation


def _told(field: FieldText) -> dict[str, Any]:
    return {
        "description": field.about,
        "type": field.form,
        "default": field.default,
        "required": field.required,
        "change": field.change,
        "example": field.example,
    }
