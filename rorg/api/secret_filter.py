"""Answers without secrets. Manifests declare which values are secret.

A service whose own words came back masked would know that it has guessed a secret of another service. So in errors for
a service, all of its words are masked that could be a secret, and other answers show only what it may know.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Mapping
from functools import cache
from typing import Any
from urllib.parse import unquote_plus

from rorg.api.inputs import Body
from rorg.core.masking import MASK, Masker
from rorg.errors import Busy
from rorg.model.catalog import DEVELOPER, EMPTY, SHORTEST_SECRET, Catalog

LINES = b"application/x-ndjson"
PROBLEM = b"application/problem+json"
LINE = re.compile(r"[^\n]*\n|[^\n]+")
LOGS = "/logs"
"""The end of the addresses whose answers are the output of services, which is not masked."""


class Hiding:
    """Masks the secrets in what the application answers."""

    def __init__(self, app: Any, masker: Masker, catalog: Callable[[], Catalog]) -> None:
        self.app, self.masker, self.catalog = app, masker, catalog

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["path"].endswith(LOGS):
            await self.app(scope, receive, send)
        elif scope["state"]["caller"].kind != "service":
            await self.app(scope, receive, _Answer(self.masker, send))
        else:
            answer = _AnswerToService(self.masker, send, scope, self.catalog)
            await self.app(scope, answer.heard(receive), answer)


class _Answer:
    """One answer. If it declares its length, it is held back until the length without secrets is known."""

    def __init__(self, masker: Masker, send: Any) -> None:
        self.masker, self.send = masker, send
        self._start: Any = None
        self._body = b""
        self._form = b""

    async def __call__(self, message: Any) -> None:
        if message["type"] == "http.response.start":
            headers = dict(message.get("headers", ()))
            self._form = headers.get(b"content-type", b"").partition(b";")[0]
            if b"content-length" in headers:
                self._start = message
            else:
                await self.send(message)
        elif self._start is None:
            await self.send({**message, "body": self._shown(message.get("body", b""))})
        else:
            self._body += message.get("body", b"")
            if not message.get("more_body", False):
                await self._whole(message)

    async def _whole(self, message: Any) -> None:
        body = self._shown(self._body)
        length = (b"content-length", str(len(body)).encode())
        headers = [length if name == b"content-length" else (name, value) for name, value in self._start["headers"]]
        await self.send({**self._start, "headers": headers})
        await self.send({**message, "body": body})

    def _shown(self, body: bytes) -> bytes:
        if not self.masker.knows:
            return body
        text = body.decode("utf-8", errors="surrogateescape")
        if self._form == LINES:
            text = "".join(map(self.masker.json, LINE.findall(text)))
        else:
            text = self.masker.json(text) if self._form.endswith(b"json") else self.masker.text(text)
        return text.encode("utf-8", errors="surrogateescape")


class _AnswerToService(_Answer):
    """One answer to a service, which must not learn of secrets by what it sent itself."""

    def __init__(self, masker: Masker, send: Any, scope: Any, catalog: Callable[[], Catalog]) -> None:
        super().__init__(masker, send)
        self.scope, self.catalog, self.body = scope, catalog, b""

    def _catalog(self) -> Catalog:
        try:
            return self.catalog()
        except Busy:  # nothing is declared yet
            return EMPTY

    def heard(self, receive: Any) -> Any:
        """`receive`, with the body kept."""

        async def hear() -> Any:
            message = await receive()
            self.body += message.get("body", b"")
            return message

        return hear

    def _shown(self, body: bytes) -> bytes:
        if not self.masker.knows or not (self._form.endswith(b"json") or self._form == LINES):
            return body if self._form.endswith(b"yaml") else super()._shown(body)
        lines = LINE.findall(body.decode("utf-8", errors="surrogateescape"))
        texts = lines if self._form == LINES else ["".join(lines)]
        return "".join(map(self._value, texts)).encode("utf-8", errors="surrogateescape")

    def _value(self, text: str) -> str:
        try:
            value = json.loads(text)
        except ValueError:
            return self.masker.text(text)
        if self._form == PROBLEM:
            said = words_of(self.scope["query_string"], self.scope["path"], self.body)
            value = error_for_service(value, said, self.masker, self._catalog())
        else:
            value = shown_to_service(value, self.masker)
        return json.dumps(value) + text[len(text.rstrip()) :]


MOST_SAID = 64 << 10
"""Characters of a call that are searched for in the error that answers it."""
_WORD = re.compile(r"[A-Za-z0-9_]+")
_OURS = frozenset(
    _WORD.findall(
        "Service Services accepted access actions already always_on annotations anything apiVersion cannot cap_add "
        "capabilities change command conflicts container developer developers devices driver env_file environment "
        "events except exclusive generation healthcheck history incarnation interlock itself labels limits manage "
        "manages manifest manifests may_act_for may_manage may_report_graph may_request may_restart member metadata "
        "method mounts needs network_mode networks nobody nothing number operation people permission pids_limit plan "
        "priority privileged profile profiles protected reason release released request requested requester "
        "requesting requests resources restart retry rorg running security_opt service services should string suspend "
        "tmpfs unknown valid value variable volumes"
    )
)
"""Words of errors and manifests, which a call may contain and an error may show."""


def shown_to_service(value: Any, masker: Masker) -> Any:
    """JSON for a service. Parts about a service have that service's secrets masked; the reasons that services give for
    requests are shown as they are."""
    if isinstance(value, list):
        return [shown_to_service(item, masker) for item in value]
    if not isinstance(value, Mapping):
        return masker.value(value)
    near = masker.of(value.get("service"))
    own = value.get("requester", DEVELOPER) != DEVELOPER and not value.get("standing")
    fields = {}
    for key, item in value.items():
        if key == "services" and isinstance(item, Mapping):
            fields[key] = {name: shown_to_service(below, masker.of(name)) for name, below in item.items()}
        elif isinstance(item, Mapping | list):
            fields[key] = near.value({key: item})[key] if _plain(item) else shown_to_service(item, near)
        else:
            fields[key] = item if key == "reason" and own else near.value({key: item})[key]
    return fields


def _plain(value: Any) -> bool:
    return isinstance(value, list) and not any(isinstance(item, Mapping | list) for item in value)


def error_for_service(error: Mapping[str, Any], said: str, masker: Masker, catalog: Catalog) -> dict[str, Any]:
    """An error for a service that has `said` something: its words are masked, because they may be secrets or guesses,
    except names that people declared."""
    known = _OURS | _names(catalog)
    details = shown_to_service({k: v for k, v in error.items() if k not in ("title", "cause", "remedy")}, masker)
    about = next((n for n, one in (error.get("services") or {}).items() if not one.get("ready")), None)
    texts = {key: unsaid(str(error.get(key, "")), said, known) for key in ("title", "cause", "remedy")}
    return {**error, **details, **{key: masker.of(about).text(text) for key, text in texts.items()}}


def _names(catalog: Catalog) -> set[str]:
    """Words in the names that people declared, not services that manage manifests."""
    managers = [service for service in catalog.services.values() if service.may_manage]
    declared = [name for name in catalog.services if not any(one.manages(name) for one in managers)]
    return {word for name in (*declared, *catalog.groups) for word in _WORD.findall(name)}


def words_of(query: bytes, path: str, body: bytes) -> str:
    """Everything that a call contains, without the names of fields that rorg declares."""
    text = body.decode("utf-8", errors="replace")
    try:
        texts = list(_texts(json.loads(text))) if text else []
    except (ValueError, RecursionError):
        texts = [text]
    return "\n".join((path, unquote_plus(query.decode("latin-1")), *texts))[:MOST_SAID]


@cache
def _fields() -> frozenset[str]:
    """The fields that a body may have. Every caller writes them, so they say nothing about a guess; an error that
    contains one, such as `for the reasons`, stays readable."""
    bodies = [Body]
    for body in bodies:
        bodies += body.__subclasses__()
    return frozenset(field for body in bodies for field in body.model_fields)


def _texts(value: Any) -> list[str]:
    if isinstance(value, dict):
        keys = [str(key) for key in value if key not in _fields()]
        return [*keys, *(text for item in value.values() for text in _texts(item))]
    if isinstance(value, list):
        return [text for item in value for text in _texts(item)]
    return [value] if isinstance(value, str) else [str(value)]


def unsaid(text: str, said: str, known: Collection[str]) -> str:
    """The text with every part masked that is also in `said` and long enough for a secret, except the words `known`."""
    covered = bytearray(len(text))
    for at in range(len(text) - SHORTEST_SECRET + 1):
        if text[at : at + SHORTEST_SECRET] in said:
            covered[at : at + SHORTEST_SECRET] = b"\x01" * SHORTEST_SECRET
    for word in _WORD.finditer(text):
        if word[0] in known:
            covered[word.start() : word.end()] = bytes(len(word[0]))
    pieces = []
    for run in re.finditer(rb"\x01+|\x00+", bytes(covered)):
        piece = text[run.start() : run.end()]
        pieces.append(MASK if run[0][0] and _WORD.search(piece) else piece)
    return "".join(pieces)
