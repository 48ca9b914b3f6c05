"""rorg validate"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn
from urllib.parse import quote

import typer

from rorg.cli.context import Context, known_engine
from rorg.cli.differences import line
from rorg.cli.options import Directory, EngineName, StateDirectory
from rorg.cli.output import dump, note, print_rows
from rorg.cli.terminal import hide
from rorg.errors import Exit, Invalid, advice
from rorg.model.diagnostics import HINT
from rorg.model.units import counted

if TYPE_CHECKING:
    from rorg.manifest.load import Loaded
    from rorg.model.diagnostics import Diagnostic

SARIF = "sarif"
LEVELS = {HINT: "note"}
"""SARIF's words for severities, if they differ from ours."""


def command(
    directory: Directory = None,
    engine: EngineName = None,
    output: Annotated[
        Literal["table", "wide", "name", "yaml", "json", "sarif"],
        typer.Option(
            "-o",
            "--output",
            help="table, wide, name, yaml, json; or sarif, which code hosts and editors show at the lines.",
        ),
    ] = "table",
    machine: Annotated[
        bool,
        typer.Option(
            "--machine", help="Also check against this machine and its engine: devices, paths, ports, limits, runtimes."
        ),
    ] = False,
    hints: Annotated[bool, typer.Option("--hints", help="Also show hints: findings that change little.")] = False,
    state_dir: StateDirectory = None,
) -> None:
    """Check manifests and report every mistake with file:line:column, for the base and for each robot with an
    overlay, or for --robot alone. With --engine process, also report missing directories and programs; with
    --machine, also what this machine and its engine cannot do. Without manifests here, check those of the running
    rorg. Each finding has a code in brackets: docs/reference/findings.md explains its effect and how a comment
    allows it.

    Example: rorg validate manifests
    """
    from rorg.manifest.documents import manifest_files

    root = directory or (Path("manifests") if os.path.isdir("manifests") else Path("."))
    client = None if directory or manifest_files(root) else Context(state_dir, engine).client()
    if client and (machine or hints):
        root, client = _here(client.call("GET", "/v1/diff")["root"]), None
    if client:
        _followed(client.call("GET", "/v1/diff"), output)
    else:
        _read(root, known_engine(engine), output, Context(state_dir, engine, root).named_robot, machine, hints)


def _here(root: str) -> Path:
    """The tree of the running rorg, if that is on this machine."""
    if not Path(root).is_dir():
        raise Invalid("check the manifests here", f"{root} is not on this machine", "the same command there")
    return Path(root)


def _read(root: Path, engine: str, output: str, robot: str, machine: bool, hints: bool) -> None:
    """Validates the files of a directory and reports the result."""
    told, loaded, robots = findings(root, engine, robot, machine, hints)
    _tell([d.as_json() for d in told], output)
    if errors := sum(d.severity == "error" for d in told):
        refuse(errors)
    catalog = loaded.catalog
    assert catalog is not None, "it has no errors"
    counts = {
        "service": sum(not s.meta for s in catalog.services.values()),
        "group": len(catalog.groups),
        "image": len(catalog.images),
        "standing request": len(catalog.requests),
        "robot": robots,
    }
    note("ok: " + ", ".join(counted(n, what) for what, n in counts.items() if n or what == "service"))


def findings(
    root: Path, engine: str, robot: str = "", machine: bool = False, hints: bool = False
) -> tuple[list[Diagnostic], Loaded, int]:
    """All findings in the files of a directory, for one robot, or for the base and all robots; the base, and the number
    of robots. From now on, no output of this process shows a secret of theirs."""
    from rorg.core.masking import Masker
    from rorg.manifest.load import load
    from rorg.manifest.overlay import robots_of

    loaded = load(root, engine=engine, robot=robot)
    masker = Masker()
    masker.learn(loaded.read)
    hide(masker)
    robots = [] if robot else robots_of(root)
    told = [*loaded.diagnostics, *(_on_this_machine(loaded, engine) if machine else ())]
    known = {(d.where, d.message) for d in told}  # the remedy may differ between robots
    for name in robots:
        overlaid = load(root, engine=engine, robot=name)
        masker.learn(overlaid.read)
        here = _on_this_machine(overlaid, engine) if machine else ()
        told += [d.on(name) for d in (*overlaid.diagnostics, *here) if (d.where, d.message) not in known]
    return sorted(d for d in told if hints or d.severity != HINT), loaded, len(robots)


def _on_this_machine(loaded: Loaded, engine: str) -> list[Diagnostic]:
    """What these manifests need and this machine, or its engine, lacks."""
    from dataclasses import replace

    from rorg.engines.facts import engine_facts
    from rorg.host.devices import look
    from rorg.host.machine import gather
    from rorg.manifest.validation.machine import check_machine, named_paths
    from rorg.model.engines import capabilities_of
    from rorg.model.options import OPTIONS

    if loaded.catalog is None or loaded.sources is None:
        return []
    devices = {d for s in loaded.catalog.services.values() for d in s.devices}
    machine = replace(gather(named_paths(loaded.catalog, loaded.sources)), plugged=look(devices))
    if not capabilities_of(engine).server:
        ignored = capabilities_of(engine).ignored(frozenset(OPTIONS))
        machine = replace(machine, lacking=dict.fromkeys(ignored, f"ignored by the {engine} engine"))
    elif (facts := engine_facts()).error:
        note(f"the engine at {facts.host} does not answer, and is not checked: {facts.error}")
    else:
        machine = replace(machine, runtimes=facts.runtimes, lacking=facts.lacking, pauses=facts.pauses)
    return check_machine(loaded.catalog, loaded.sources, machine)


def _followed(told: dict[str, Any], output: str) -> None:
    """Reports what the running rorg found, which has read its tree again."""
    _tell([*told["errors"], *told.get("warnings", ())], output)
    if told["errors"]:
        refuse(len(told["errors"]))
    note(f"ok: {told['root']}, as the running rorg reads it")


def _tell(diagnostics: list[dict[str, Any]], output: str) -> None:
    if output == SARIF:
        from rorg import __version__
        from rorg.manifest.validation.codes import CODES

        return dump(sarif(diagnostics, CODES, __version__), "json")
    if output != "table":
        print_rows(diagnostics, output, ("file", "line", "column", "severity", "message", "remedy", "code"))
    for diagnostic in diagnostics if output == "table" else ():
        note(line(diagnostic))


def refuse(errors: int) -> NoReturn:
    """Ends the command, because manifests have this many errors."""
    note(f"{counted(errors, 'error')}: rorg would refuse these manifests")
    sys.exit(int(Exit.USAGE))


SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
FORM = "form"
"""The rule for findings without a code."""


def sarif(diagnostics: Sequence[Mapping[str, Any]], codes: Mapping[str, Any], version: str) -> dict[str, Any]:
    """Findings as SARIF 2.1.0, the Static Analysis Results Interchange Format of OASIS, which code hosts show at the
    lines. `diagnostics` are JSON; `codes`: code -> severity, cause and remedy. Paths stay relative to the current
    directory."""
    used = sorted({str(f["code"]) or FORM for f in diagnostics})
    driver = {"name": "rorg", "version": version, "rules": [_rule(code, codes) for code in used]}
    results = [_result(f, used.index(str(f["code"]) or FORM)) for f in diagnostics]
    run = {"tool": {"driver": driver}, "columnKind": "unicodeCodePoints", "results": results}
    return {"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}


def _rule(code: str, codes: Mapping[str, Any]) -> dict[str, Any]:
    about = codes.get(code)
    if about is None:
        return {"id": code, "shortDescription": {"text": "A manifest does not have the form of its kind."}}
    return {
        "id": code,
        "shortDescription": {"text": about.cause},
        "help": {"text": f"{about.advice}. See docs/reference/findings.md#{code}."},
        "defaultConfiguration": {"level": LEVELS.get(about.severity, about.severity)},
    }


def _result(diagnostic: Mapping[str, Any], rule: int) -> dict[str, Any]:
    place = {
        "artifactLocation": {"uri": quote(str(diagnostic["file"]))},
        "region": {"startLine": diagnostic["line"], "startColumn": diagnostic["column"]},
    }
    return {
        "ruleId": diagnostic["code"] or FORM,
        "ruleIndex": rule,
        "level": LEVELS.get(str(diagnostic["severity"]), diagnostic["severity"]),
        "message": {"text": f"{diagnostic['message']}{advice(diagnostic['remedy'])}"},
        "locations": [{"physicalLocation": place}],
    }
