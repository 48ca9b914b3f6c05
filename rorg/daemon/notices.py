"""Which notifications the entries of the journal are worth, for one target, and when: pure functions of entries and
time."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from rorg.model.policy import NOTIFY_FIELDS, NotifyTarget

KINDS = {
    "lost": "lost",
    "update-failed": "quarantined",
    "revision-failed": "failed",
    "pressure": "pressure",
    "unplugged": "unplugged",
    "plugged": "unplugged",
}
"""Kind of an entry of the journal -> kind of its notification."""
ORDERED = frozenset({"held", "replaced"})
"""Causes of `lost` that a person ordered or a change brought: they are no trouble."""
LONGEST = 2000
"""Characters of a message."""
FIELD = re.compile(r"\{(" + "|".join(NOTIFY_FIELDS) + r")\}")
Subject = tuple[str, str]
"""(kind, service)."""


@dataclass(frozen=True, slots=True)
class Notification:
    """One message to a target."""

    robot: str
    kind: str
    """Of NOTIFY_KINDS."""
    event: str
    """The kind of its entry in the journal."""
    service: str
    """Empty for pressure and for a revision."""
    message: str
    cause: str
    """Of `lost`: a stable word."""
    at: str
    seq: int
    suppressed: int = 0
    """Earlier ones of the same kind and service that were not sent."""

    @property
    def subject(self) -> Subject:
        return self.kind, self.service


@dataclass(frozen=True, slots=True)
class Notices:
    """The notifications that one target has had lately, and those that wait. Times are seconds of the clock."""

    sent: Mapping[Subject, float] = field(default_factory=dict)
    """When each was last sent, within the target's `every`."""
    waiting: Mapping[Subject, Notification] = field(default_factory=dict)
    next: float | None = None
    """When the first of those that wait is due."""


def notification(entry: Mapping[str, Any], robot: str) -> Notification | None:
    """The notification of an entry; None if it is worth none."""
    kind, cause = KINDS.get(entry["kind"], ""), str(entry.get("cause", ""))
    if not kind or (kind == "lost" and cause in ORDERED):
        return None
    message, service = str(entry["message"])[:LONGEST], str(entry.get("service", ""))
    return Notification(robot, kind, entry["kind"], service, message, cause, entry["at"], entry["seq"])


def due(
    before: Notices, entries: Iterable[Mapping[str, Any]], target: NotifyTarget, robot: str, now: float
) -> tuple[Notices, list[Notification]]:
    """What to send now, in order, after these new entries; the rest waits until its time, the newest of each subject
    with the number of those before it."""
    sent = {subject: at for subject, at in before.sent.items() if now - at < target.every}
    waiting, to_send = dict(before.waiting), list[Notification]()

    def send(one: Notification) -> None:
        to_send.append(one)
        if target.every:
            sent[one.subject] = now

    for subject in [s for s in waiting if s not in sent]:
        send(waiting.pop(subject))
    for entry in entries:
        one = notification(entry, robot)
        if one is None or one.kind not in target.kinds:
            continue
        if one.subject not in sent:
            send(one)
            continue
        earlier = waiting.pop(one.subject, None)
        waiting[one.subject] = replace(one, suppressed=earlier.suppressed + 1) if earlier else one
    following = min((sent[subject] + target.every for subject in waiting), default=None)
    return Notices(sent, waiting, following), to_send


def body(one: Notification, template: str | Mapping[str, Any] | None) -> tuple[bytes, str]:
    """The body of a notification, and its media type."""
    values = asdict(one)
    if isinstance(template, str):
        return _filled(template, values).encode(errors="replace"), "text/plain; charset=utf-8"
    content = values if template is None else _filled(template, values)
    return json.dumps(content).encode(), "application/json"


def _filled(template: Any, values: Mapping[str, Any]) -> Any:
    """A template with the values of its fields."""
    if isinstance(template, str):
        return FIELD.sub(lambda match: str(values[match[1]]), template)
    if isinstance(template, Mapping):
        return {key: _filled(item, values) for key, item in template.items()}
    return [_filled(item, values) for item in template] if isinstance(template, list | tuple) else template
