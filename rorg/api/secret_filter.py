"""Answers without secrets, whoever asks: manifests say which values those are."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

from rorg.api.hiding_from_services import error_for_service, shown_to_service, words_of
from rorg.core.masking import Masker
from rorg.errors import Busy
from rorg.model.catalog import EMPTY, Catalog

LINES = b"application/x-ndjson"
PROBLEM = b"application/problem+json"
LINE = re.compile(r"[^\n]*\n|[^\n]+")
LOGS = "/logs"
"""How the addresses end whose answers are what services print, and not rorg's word."""


class Hiding:
    """In front of the application: what it answers goes through a Masker."""

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
    """One answer. What says how long it is is held back until it is known how long it is without secrets."""

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
    """One answer to a service, which is told nothing of secrets by what it said itself."""

    def __init__(self, masker: Masker, send: Any, scope: Any, catalog: Callable[[], Catalog]) -> None:
        super().__init__(masker, send)
        self.scope, self.catalog, self.body = scope, catalog, b""

    def _catalog(self) -> Catalog:
        try:
            return self.catalog()
        except Busy:  # nothing is declared yet
            return EMPTY

    def heard(self, receive: Any) -> Any:
        """`receive`, with what comes by it kept."""

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
