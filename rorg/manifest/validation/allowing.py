"""Warnings that someone has reviewed and allowed: `# rorg: allow CODE: reason` on the line or before it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

from rorg.manifest.validation.codes import CODES
from rorg.manifest.yaml_source import Allow
from rorg.model.diagnostics import Diagnostic, nearest

WITHOUT_REASON, UNKNOWN, UNUSED = "allow-without-reason", "allow-unknown-code", "allow-without-effect"


def allowed(found: Iterable[Diagnostic], allows: Collection[Allow], machine: bool) -> list[Diagnostic]:
    """Returns the remaining diagnostics, and those about the comments themselves. `machine`: whether findings about
    this machine are included. Without them, a comment that allows one may look unused."""
    good: dict[tuple[str, str], list[Allow]] = {}
    for allow in allows:
        if allow.reason and allow.code in CODES:
            good.setdefault((allow.where.file, allow.code), []).append(allow)
    used: set[Allow] = set()
    left = []
    for diagnostic in found:
        near = good.get((diagnostic.where.file, diagnostic.code), []) if diagnostic.severity == "warning" else []
        by = [a for a in near if a.lines[0] <= diagnostic.where.line <= a.lines[1]]
        used.update(by)
        if not by:
            left.append(diagnostic)
    return [*left, *_wrong(allows, used, machine)]


def _wrong(allows: Iterable[Allow], used: Collection[Allow], machine: bool) -> Iterator[Diagnostic]:
    for allow in allows:
        code = CODES.get(allow.code)
        if code is None:
            remedy = nearest(allow.code, CODES) or "one of docs/reference/findings.md"
            yield _warning(allow, f"there is no finding '{allow.code}'", remedy, UNKNOWN)
        elif not allow.reason:
            remedy = f"# rorg: allow {allow.code}: why this is right here"
            yield _warning(
                allow,
                f"'{allow.code}' is allowed without a reason, so the comment has no effect",
                remedy,
                WITHOUT_REASON,
            )
        elif allow not in used and (machine or not code.machine):
            yield _warning(allow, f"nothing here is '{allow.code}'", "dropping this comment", UNUSED)


def _warning(allow: Allow, message: str, remedy: str, code: str) -> Diagnostic:
    return Diagnostic(allow.where, message, remedy, "warning", code)
