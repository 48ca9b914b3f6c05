"""Parses the requests file, with a place for every mistake, and renders it so that it reads back the same."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import yaml

from rorg.manifest.yaml_source import Document, Path, read_yaml
from rorg.model.catalog import HIGHEST_PRIORITY, Hold, Request
from rorg.model.diagnostics import Diagnostic, nearest
from rorg.model.units import format_duration, parse_duration, parse_lease, parse_time, stamp
from rorg.store.requests_document import RequestsDocument

HEADER = """\
# What this robot is asked to run. rorg reads the file after every change; after a mistake the last good version counts.
# requests: id (chosen by the requester), requester, services, and optionally `incarnation` (the run of the requester
# that it is bound to, which rorg fills in) and `ttl` (a lease, which a new time in `renewed` extends).
# restarts, retries: when a restart of a service, or another try of its failed change, was requested.
# holds: services that must not be active until a time. suspended: rorg changes nothing until then. For both, rorg adds
# the `duration`, and the end in seconds since the `boot`: it counts if the clock is set.
# removals: undeclared services whose removal a person has confirmed, though something still names them.
# down: true while everything is removed, despite all requests; then a time, until a person runs the robot again.
"""
PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./@ -]*(?<! )")
"""Text without quotes, unless the dumper quotes it. Everything else is quoted, because dumper and reader disagree about
what else looks like a number, a time or a truth value."""


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]
    pass


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    style = None if PLAIN.fullmatch(text) else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _text)
_FIELDS = ("id", "requester", "services", "reason", "incarnation", "priority", "ttl", "renewed")
_HOLD = {"until", "reason", "duration", "uptime", "boot"}
_KEYS = ("requests", "restarts", "retries", "holds", "suspended", "removals", "down", "purge", "forget")


def parse(text: str, file: str) -> tuple[RequestsDocument | None, list[Diagnostic]]:
    """Return the content of a requests file, or everything that is wrong with it, with places."""
    if not any(line.strip() and not line.lstrip().startswith("#") for line in text.splitlines()):
        return RequestsDocument(), []
    document, diagnostics = read_yaml(text, file, nul=True)
    if document is None or diagnostics:
        return None, diagnostics
    reader = _Reader(document)
    asked = reader.read()
    return (None if reader.diagnostics else asked), reader.diagnostics


class _Reader:
    def __init__(self, document: Document) -> None:
        self.document = document
        self.diagnostics: list[Diagnostic] = []

    def error(self, path: Path, message: str, remedy: str = "", key: bool = False) -> None:
        self.diagnostics.append(Diagnostic(self.document.where(path, key), message, remedy))

    def read(self) -> RequestsDocument:
        value = self.document.value
        if not isinstance(value, dict):
            self.error((), "the file must be a mapping", "`requests:` with a list below it")
            return RequestsDocument()
        for key in value:
            if key not in _KEYS:
                self.error((key,), f"unknown key '{key}'", nearest(key, _KEYS), key=True)
        entries = value.get("requests") or []
        if not isinstance(entries, list):
            self.error(("requests",), "must be a list")
            entries = []
        requests = [r for i, entry in enumerate(entries) if (r := self.request(("requests", i), entry))]
        seen: set[tuple[str, str]] = set()
        for index, request in enumerate(requests):
            if request.key in seen:
                self.error(
                    ("requests", index, "id"), f"a second request '{request.id}' of {request.requester}", "another id"
                )
            seen.add(request.key)
        holds = value.get("holds") or {}
        if not isinstance(holds, dict):
            self.error(("holds",), "must map services to {until, reason}")
            holds = {}
        suspended = value.get("suspended")
        return RequestsDocument(
            tuple(requests),
            self.times("restarts", value.get("restarts") or {}),
            {n: h for n, v in holds.items() if (h := self.hold(("holds", n), v))},
            self.hold(("suspended",), suspended) if suspended else None,
            self.removals(value.get("removals") or []),
            down=bool(value.get("down")),
            down_since=self.down_since(value.get("down", False)),
            purge=self.truth("purge", value),
            forget=self.truth("forget", value),
            retries=self.times("retries", value.get("retries") or {}),
        )

    def down_since(self, value: Any) -> str:
        """true while the robot goes down; a time once it is down."""
        if isinstance(value, bool):
            return ""
        at = self.time(("down",), value)
        return "" if at is None else stamp(at)

    def truth(self, key: str, content: Mapping[str, Any]) -> bool:
        value = content.get(key, False)
        if not isinstance(value, bool):
            self.error((key,), "must be true or false")
        return value is True

    def removals(self, value: Any) -> tuple[str, ...]:
        if not (isinstance(value, list) and all(isinstance(name, str) for name in value)):
            self.error(("removals",), "must be a list of names", "[NAME]")
            return ()
        return tuple(dict.fromkeys(value))

    def hold(self, path: Path, value: Any) -> Hold | None:
        if not isinstance(value, dict) or not {"until"} <= set(value) <= _HOLD:
            self.error(path, "must be a mapping with until and reason")
            return None
        until, reason = self.time((*path, "until"), value["until"]), str(value.get("reason") or "")
        if until is None or value.get("duration") is None:
            return None if until is None else Hold(until, reason)
        try:
            duration, uptime = parse_duration(value["duration"]), parse_duration(value.get("uptime", 0))
        except ValueError as error:
            self.error(path, str(error))
            return None
        return Hold(until, reason, duration, uptime, str(value.get("boot") or ""))

    def time(self, path: Path, value: Any) -> float | None:
        try:
            return parse_time(value)
        except ValueError as error:
            self.error(path, str(error))
            return None

    def times(self, key: str, value: Any) -> dict[str, str]:
        if not isinstance(value, dict):
            self.error((key,), "must map services to times", "NAME: 2026-01-31T12:00:00Z")
            return {}
        times = {name: self.time((key, name), written) for name, written in value.items()}
        return {str(name): stamp(at) for name, at in times.items() if at is not None}

    def ttl(self, path: Path, value: Any) -> float | None:
        try:
            return None if value is None else parse_lease(value)
        except ValueError as error:
            self.error((*path, "ttl"), str(error))
            return None

    def request(self, path: Path, entry: Any) -> Request | None:
        if not isinstance(entry, dict):
            self.error(path, "a request must be a mapping with id, requester and services")
            return None
        before = len(self.diagnostics)
        for key in entry:
            if key not in _FIELDS:
                self.error((*path, key), f"unknown key '{key}'", nearest(key, _FIELDS), key=True)
        for key in ("id", "services"):
            if not entry.get(key):
                self.error(path, f"'{key}' is missing")
        services = entry.get("services") or []
        if services and not (isinstance(services, list) and all(isinstance(s, str) for s in services)):
            self.error((*path, "services"), "must be a list of names", "[NAME]")
        for key in ("id", "requester", "reason", "incarnation", "renewed"):
            if not isinstance(entry.get(key, ""), str | None):
                self.error((*path, key), f"'{key}' must be text", "quotes around it")
        ttl, priority = self.ttl(path, entry.get("ttl")), entry.get("priority")
        if priority is not None and not (type(priority) is int and 0 <= priority <= HIGHEST_PRIORITY):
            self.error((*path, "priority"), f"'priority' must be a whole number from 0 to {HIGHEST_PRIORITY}")
        if len(self.diagnostics) > before:
            return None
        return Request(
            entry["id"],
            entry.get("requester") or "developer",
            tuple(services),
            entry.get("reason") or "",
            entry.get("incarnation"),
            priority=priority,
            ttl=ttl,
            renewed=entry.get("renewed") or "",
            where=self.document.where(path),
        )


def render(document: RequestsDocument) -> str:
    """The file's text."""
    content = {
        "restarts": dict(document.restarts),
        "retries": dict(document.retries),
        "holds": {name: _hold(hold) for name, hold in document.holds.items()},
        "suspended": document.suspended and _hold(document.suspended),
        "removals": list(document.removals),
    }
    content = {key: value for key, value in content.items() if value}
    requests = "".join(_entry(request) for request in document.requests)
    return (
        HEADER
        + (f"requests:\n{requests}" if requests else "requests: []\n")
        + (_yaml(content) if content else "")
        + (f"down: {document.down_since or 'true'}\n" if document.down else "")
        + ("purge: true\n" if document.purge else "")
        + ("forget: true\n" if document.forget else "")
    )


@lru_cache(maxsize=1024)
def _entry(request: Request) -> str:
    """The text of one request, in a list without indentation. Cached, so that a change of one does not render all
    others again."""
    entry = {name: getattr(request, name) for name in _FIELDS}
    entry["services"] = list(request.services)
    entry["ttl"] = None if request.ttl is None else format_duration(request.ttl)
    return _yaml([{name: value for name, value in entry.items() if value not in (None, "")}])


def _yaml(content: Any) -> str:
    text: str = yaml.dump(
        content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True
    )
    return text


def _hold(hold: Hold) -> dict[str, str]:
    reason = {"reason": hold.reason} if hold.reason else {}
    if hold.duration is None:
        return {"until": stamp(hold.until), **reason}
    ends = {"duration": format_duration(hold.duration), "uptime": format_duration(hold.uptime), "boot": hold.boot}
    return {"until": stamp(hold.until), **ends, **reason}
