"""Who may use the page: whoever has the token of its address, from this page alone.

The page may do whatever the user who started it may do. So the token opens it, other pages of the same browser cannot
use it (cookie, Origin, Sec-Fetch-Site), a name that another server points here does not reach it (Host), and nothing
that it shows becomes code (Content-Security-Policy).
"""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

POLICY = "; ".join(
    (
        "default-src 'none'",
        *(f"{part}-src 'self'" for part in ("script", "style", "img", "connect", "worker")),
        *(f"{part} 'none'" for part in ("base-uri", "form-action", "frame-ancestors")),
    )
)
HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)


class Gate:
    """The ASGI application in front of the page, on one port."""

    def __init__(self, app: Any, token: str, port: int, read_only: bool) -> None:
        self.app, self.token, self.read_only = app, token, read_only
        self.hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}
        self.cookie = f"rorg_ui_{port}"

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
        if scope["type"] != "http":
            return

        async def sending(message: Any) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *HEADERS]
            await send(message)

        refusal = self._refusal(scope)
        if refusal:
            await _answer(sending, 403, refusal)
        elif self._opens(scope):
            cookie = f"{self.cookie}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            await _answer(sending, 303, "", ((b"location", b"/"), (b"set-cookie", cookie.encode())))
        elif not self._known(scope):
            await _answer(sending, 401, "open the address that `rorg ui` has printed: it has the token")
        else:
            await self.app(scope, receive, sending)

    def _refusal(self, scope: Any) -> str:
        """Return why a call is refused whatever it carries; "" if it is not."""
        headers = _headers(scope)
        if headers.get("host", "") not in self.hosts:
            return "this name does not lead here"
        origin, site = headers.get("origin"), headers.get("sec-fetch-site", "none")
        if origin is not None and origin.partition("://")[2] not in self.hosts:
            return "another page may not use this one"
        if site not in ("same-origin", "none") and not (scope["path"] == "/" and scope["method"] == "GET"):
            return "another page may not use this one"
        if self.read_only and scope["method"] not in ("GET", "HEAD"):
            return "this page only reads (`rorg ui --read-only`)"
        return ""

    def _opens(self, scope: Any) -> bool:
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        return scope["path"] == "/" and bool(given) and hmac.compare_digest(given.encode(), self.token.encode())

    def _known(self, scope: Any) -> bool:
        try:
            cookie = SimpleCookie(_headers(scope).get("cookie", "")).get(self.cookie)
        except CookieError:
            return False
        return cookie is not None and hmac.compare_digest(cookie.value.encode(), self.token.encode())


def _headers(scope: Any) -> Mapping[str, str]:
    return {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}


async def _answer(send: Any, status: int, text: str, more: tuple[tuple[bytes, bytes], ...] = ()) -> None:
    # Whoever has no token keeps no connection.
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close"), *more]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": text.encode()})
