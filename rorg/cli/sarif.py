"""Findings as SARIF 2.1.0, the Static Analysis Results Interchange Format of OASIS: code hosts show it at its lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote

SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
FORM = "form"
"""The rule of what has no code of its own."""


def sarif(found: Sequence[Mapping[str, Any]], codes: Mapping[str, Any], version: str) -> dict[str, Any]:
    """One run. `found`: diagnostics as JSON; `codes`: what holds of each code, with severity, cause and remedy; paths
    are as they were given to rorg, relative to the directory that it was called in."""
    used = sorted({str(f["code"]) or FORM for f in found})
    driver = {"name": "rorg", "version": version, "rules": [_rule(code, codes) for code in used]}
    results = [_result(f, used.index(str(f["code"]) or FORM)) for f in found]
    run = {"tool": {"driver": driver}, "columnKind": "unicodeCodePoints", "results": results}
    return {"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}


def _rule(code: str, codes: Mapping[str, Any]) -> dict[str, Any]:
    about = codes.get(code)
    if about is None:
        return {"id": code, "shortDescription": {"text": "A manifest is not as its kind says."}}
    return {
        "id": code,
        "shortDescription": {"text": about.cause},
        "help": {"text": f"Try {about.remedy}. See docs/reference/findings.md#{code}."},
        "defaultConfiguration": {"level": about.severity},
    }


def _result(found: Mapping[str, Any], rule: int) -> dict[str, Any]:
    tail = f"; try {found['remedy']}" if found["remedy"] else ""
    place = {
        "artifactLocation": {"uri": quote(str(found["file"]))},
        "region": {"startLine": found["line"], "startColumn": found["column"]},
    }
    return {
        "ruleId": found["code"] or FORM,
        "ruleIndex": rule,
        "level": found["severity"],
        "message": {"text": f"{found['message']}{tail}"},
        "locations": [{"physicalLocation": place}],
    }
