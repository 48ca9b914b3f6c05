"""Answers without secrets, whoever asks: manifests say which values those are."""

from __future__ import annotations

import re
from typing import Any

from rorg.core.masking import Masker

LINES = b"application/x-ndjson"
LINE = re.compile(r"[^\n]*\n|[^\n]+")
LOGS = "/logs"
"""How the addresses end whose answers are what services print, and not rorg's word."""


class Hiding:
    """In front of the application: what it answers goes through a Masker."""

    def __init__(self, app: Any, masker: Masker) -> None:
        self.app, self.masker = app, masker

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["path"].endswith(LOGS):
            await self.app(scope, receive, send)
        else:
            await self.app(scope, receive, _Answer(self.masker, send))


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
