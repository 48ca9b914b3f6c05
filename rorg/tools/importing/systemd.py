"""Imports systemd units: one Service for each service, one Group for each target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic
from rorg.tools.importing.manifests import NOTE, Imported, Made
from rorg.tools.importing.systemd_service import ServiceOf
from rorg.tools.importing.systemd_unit import Unit, is_template, read_unit

NAMING = ("Wants", "Requires", "BindsTo", "Requisite")
"""Keys that name units to start."""


def from_systemd(texts: Mapping[Path, str], image: str, tree: Path, skip: bool = False) -> Imported:
    """Imports units, given as path -> text. `image`: the image of the services; `tree`: directory of the manifests;
    `skip`: leave out units that cannot be carried over."""
    try:
        units = {unit.path.name: unit for unit in (read_unit(path, text) for path, text in texts.items())}
    except TooMuch as bound:
        return Imported(diagnostics=(bound.diagnostic,))
    units = _instances(units)
    made, diagnostics = dict[str, Made](), list[Diagnostic]()
    for unit in units.values():
        own, told = _made(unit, units, image, tree)
        told += [
            _error(unit, f"another unit is called {one.name}, too", "another name") for one in own if one.name in made
        ]
        if any(d.severity == "error" for d in told) and skip:
            told = [replace(d, message=f"skipped: {d.message}", severity="warning") for d in told]
            own = []
        diagnostics += told
        made |= {one.name: one for one in own}
    return Imported(tuple(made.values()), diagnostics=tuple(sorted(diagnostics)))


def _made(unit: Unit, units: Mapping[str, Unit], image: str, tree: Path) -> tuple[list[Made], list[Diagnostic]]:
    """The manifests of a unit, and findings about them."""
    diagnostics: list[Diagnostic] = []
    name = unit.path.name
    if name.endswith(".target"):
        return _group(unit, units, diagnostics), diagnostics
    if not name.endswith(".service"):
        return [], [_error(unit, f"{name} is neither a service nor a target", "the .service that it starts")]
    if is_template(name):
        remedy = f"`rorg import systemd {name.replace('@', '@INSTANCE')}`"
        return [], [_error(unit, f"{name} is a template, and no instance of it is named", remedy)]
    return [ServiceOf(unit, units, image, tree, diagnostics).made()], diagnostics


def _error(unit: Unit, message: str, remedy: str) -> Diagnostic:
    return Diagnostic(unit.where(), message, remedy)


def _instances(units: Mapping[str, Unit]) -> dict[str, Unit]:
    """The units, with the instances that they name, or else the default instance, in place of each template."""
    instances: dict[str, Unit] = {}
    for name, unit in units.items():
        prefix, at, suffix = name.partition("@")
        named = [
            w for u in units.values() for w in u.words(*NAMING) if w.startswith(f"{prefix}@") and w.endswith(suffix)
        ]
        default = unit.last("DefaultInstance")
        named = [w for w in dict.fromkeys(named) if w != name] or [f"{prefix}@{default}{suffix}"] * bool(default)
        if not at or not is_template(name) or not named:
            instances[name] = unit
        else:
            instances |= {one: unit.of_instance(one) for one in named if one not in units}
    return instances


def _group(unit: Unit, units: Mapping[str, Unit], diagnostics: list[Diagnostic]) -> list[Made]:
    """The group of the imported units that a target starts."""
    named = set(unit.words("Wants", "Requires", "BindsTo"))
    members = [u.name for n, u in units.items() if n.endswith(".service") and n in named]
    members += [
        u.name for u in units.values() if unit.path.name in u.words("WantedBy", "RequiredBy") and u.name not in members
    ]
    if not members:
        diagnostics.append(Diagnostic(unit.where(), f"no service of {unit.path.name} is imported with it", "", NOTE))
        return []
    return [
        Made("Group", unit.name, {"services": members}, (f"From {unit.path}.",), description=unit.last("Description"))
    ]
