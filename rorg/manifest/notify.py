"""Notifications: the part `notify` of the kind Policy."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, model_validator

from rorg.manifest.fields import Written, field
from rorg.manifest.option_forms import Duration, Interval, Name, Strict, Words
from rorg.manifest.probes import Absolute
from rorg.model.policy import NOTIFY_FIELDS

FIELD = re.compile(r"\{([A-Za-z_]+)\}")
"""A field in a template."""


def _url(value: str) -> str:
    try:
        parts = urlsplit(value)
        fine = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        fine = False
    if not fine or not value.isascii() or not value.isprintable() or " " in value:
        raise ValueError("must be a URL such as https://ntfy.example.org/nora")
    if "@" in parts.netloc:
        raise ValueError("must not hold a password; write the header Authorization into `headers_file`")
    return value


def _texts(value: Any) -> Iterator[str]:
    """All texts of a template."""
    if isinstance(value, str):
        yield value
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _texts(item)


def _template(value: str | dict[str, Any]) -> str | dict[str, Any]:
    for name in (name for text in _texts(value) for name in FIELD.findall(text)):
        if name not in NOTIFY_FIELDS:
            raise ValueError(f"unknown field '{{{name}}}'; the fields are {', '.join(NOTIFY_FIELDS)}")
    if isinstance(value, str) and re.match(r"\s*[\[{]\s*[\"{]", value):
        raise ValueError("JSON as text would break at the first quotation mark; write a mapping, such as {text: ...}")
    return value


class Webhook(Strict):
    """A URL that each notification is posted to."""

    url: Annotated[str, AfterValidator(_url), Written("URL")] | None = field(
        "Where to post: an http:// or https:// URL. No redirect is followed.", "https://ntfy.example.org/nora"
    )
    url_file: Absolute | None = field(
        "A file of the robot whose first line is the URL, instead of `url`: anyone with the URL of a Slack webhook "
        "can post there.",
        "/etc/rorg/slack.url",
    )
    headers_file: Absolute | None = field(
        "A file of the robot with more headers, each on a line `NAME: VALUE`, such as Authorization.",
        "/etc/rorg/ntfy.headers",
    )
    template: Annotated[str | dict[str, Any], AfterValidator(_template), Written("text | mapping")] | None = field(
        "The body: a text, or a mapping that is sent as JSON. In its texts, {FIELD} stands for a field of the "  # noqa: RUF027
        f"notification: {', '.join(NOTIFY_FIELDS)}.",
        {"text": "{robot}: {message}"},
        unset="all fields as JSON",
    )

    @model_validator(mode="after")
    def _one(self) -> Webhook:
        if (self.url is None) == (self.url_file is None):
            raise ValueError("exactly one of url, url_file must be given")
        return self


class Notify(Strict):
    """Someone to notify: exactly one of `command` and `webhook`."""

    name: Name = field("Its name in logs and in `rorg doctor`.", "slack", ...)
    command: Annotated[Words, Field(min_length=1)] | None = field(
        "A command that rorg runs on the robot as its own user, without a shell. It reads the notification as JSON "
        "from stdin.",
        ["/usr/local/bin/siren", "--short"],
    )
    webhook: Webhook | None = field("A URL to post to.", {"url": "https://ntfy.example.org/nora"})
    on: Annotated[list[Literal["lost", "quarantined", "failed", "pressure", "unplugged"]], Field(min_length=1)] = field(
        "What to notify of: a service that live requests use is lost; the change of a service failed and is "
        "quarantined; a revision of the manifests failed; measures against pressure begin, change or end; a device "
        "is unplugged or back.",
        ["lost", "failed"],
        lambda: ["lost", "quarantined", "failed", "pressure", "unplugged"],
    )
    every: Duration = field(
        "At most one notification of a kind about a service in this time. The newest of the others follows when it "
        "is over, with their number in `suppressed`.",
        "1m",
        10.0,
    )
    timeout: Annotated[Interval, Field(le=60)] = field("Longest time for one attempt.", "5s", 10.0)

    @model_validator(mode="after")
    def _one(self) -> Notify:
        if (self.command is None) == (self.webhook is None):
            raise ValueError("exactly one of command, webhook must be given")
        return self


def _names(value: list[Notify]) -> list[Notify]:
    names = [target.name for target in value]
    if again := next((name for name in names if names.count(name) > 1), ""):
        raise ValueError(f"the name '{again}' is used twice")
    return value


Targets = Annotated[list[Notify], Field(max_length=16), AfterValidator(_names)]
