"""Every call of the API as a value, and the rules for repeating a failed one. Without I/O or clock, because both
clients share it."""

from __future__ import annotations

import json
import os
import re
import threading
from typing import TYPE_CHECKING, Any, Generic, Mapping, Sequence, TypeVar
from urllib.parse import quote, urlencode

from rorg_client.errors import Error, Unreachable, invalid, problem, unreachable
from rorg_client.names import check_names
from rorg_client.wire import Answer

if TYPE_CHECKING:
    from rorg_client.types import GroupView, ManifestView, RequestView, ServiceView, Usage, Why

PATIENCE = 30.0
"""Seconds for which a call is repeated while rorg does not answer: a restart of rorg takes less."""
TTL = 10.0
"""Seconds of a lease; it is renewed three times as often."""
HELD = 10.0
"""Seconds for which rorg may hold back an answer until it has acted on an earlier change."""
FIRST_PAUSE, LONGEST_PAUSE = 0.1, 1.0
"""Shortest and longest pause between two attempts, in seconds."""
NOT_NOW = (429, 503)
"""HTTP statuses of calls that were not done and can be repeated: too many calls, or rorg is busy."""
MANIFESTS = "/v1/manifests"
T = TypeVar("T")


class Newest:
    """The newest changes that a client knows of: later reads must not be older."""

    def __init__(self) -> None:
        self.change, self.manifest = 0, 0
        self._pid, self._lock = os.getpid(), threading.Lock()

    def note(self, call: Call[Any], answer: Answer) -> None:
        number = generation(answer)
        if self._pid != os.getpid():  # a thread of the parent may have held the lock when this process was forked
            self._pid, self._lock = os.getpid(), threading.Lock()
        with self._lock:
            self.change = max(self.change, number)
            if call.path.startswith(MANIFESTS):
                self.manifest = max(self.manifest, number)


class Call(Generic[T]):
    """One call, and the type of its answer. `pick`: the field of the answer to return."""

    def __init__(self, method: str, path: str, body: Any = None, pick: str = "", wait: float | None = None) -> None:
        if not re.fullmatch(r"/[!-~]*", path):
            raise invalid(f"cannot {method} {path!r}", "that is not a path", "letters, digits and %XX")
        self.method, self.path, self.pick, self.wait = method, path, pick, wait
        self.body = None if body is None else json.dumps(body).encode()
        self.renewal = method == "POST" and path.partition("?")[0].endswith("/renew")
        self.once = (method == "POST" and not self.renewal) or (method != "GET" and path.startswith(MANIFESTS))
        """Whether a second time has another effect: then it is only repeated if the first one surely did not arrive."""

    def at(self, left: float) -> str:
        """The path, with the time left to wait."""
        if self.wait is None:
            return self.path
        name = "timeout" if self.method == "GET" else "wait"
        return f"{self.path}{'&' if '?' in self.path else '?'}{name}={max(0.0, left):.3f}"

    def not_before(self, newest: Newest) -> int:
        """The change that the answer must know of. A request may name what an earlier change declared; renewals and
        releases never wait."""
        return (
            newest.change
            if self.method == "GET"
            else 0
            if self.renewal or self.method == "DELETE"
            else (newest.manifest)
        )

    def headers(self, newest: Newest) -> dict[str, str]:
        number = self.not_before(newest)
        return {"rorg-not-before": str(number)} if number else {}

    def told(self, answer: Answer) -> Any:
        """The content of an answer. Raises a subclass of Error."""
        if answer.status >= 400:
            raise problem(answer.status, answer.body)
        if not answer.headers.get("content-type", "").startswith("application/json"):
            return answer.body.decode(errors="replace") if answer.body else None
        found = json.loads(answer.body)
        return found[self.pick] if self.pick else found


def generation(answer: Answer) -> int:
    """The generation of the answered change; 0 if it was none."""
    found = answer.headers.get("rorg-generation", "")
    return int(found) if found.isdigit() else 0


class Failed(Exception):
    """A failed attempt: no answer, or "not now". `sent`: it may have arrived. `stale`: it used a connection kept from
    an earlier call, which says nothing about the current rorg. `after`: seconds until it may be repeated."""

    def __init__(self, error: BaseException, sent: bool, stale: bool = False, after: float = 0.0) -> None:
        self.error, self.sent, self.stale, self.after = error, sent, stale, after
        super().__init__(str(error))


def not_now(answer: Answer) -> Failed | None:
    """The failure that an answer "not now" stands for."""
    if answer.status not in NOT_NOW:
        return None
    # A busy rorg is asked again soon: it is back within a second.
    after = answer.headers.get("retry-after", "") if answer.status == 429 else ""
    return Failed(problem(answer.status, answer.body), sent=False, after=float(after) if after.isdigit() else 0.0)


class Attempts:
    """Decides when a failed call is repeated. `patience` counts from the first failure."""

    def __init__(self, call: Call[Any], patience: float, where: str) -> None:
        self.call, self.patience, self.where = call, patience, where
        self.pause, self.end = FIRST_PAUSE, -1.0

    def again(self, failed: Failed, now: float) -> float:
        """Seconds until the next attempt; raises the error if there is none."""
        if failed.stale and not self.call.once:
            return 0.0
        if self.end < 0:
            self.end = now + self.patience
        pause = max(self.pause, failed.after)
        if (failed.sent and self.call.once) or now + pause > self.end:
            raise self._error(failed) from failed.error
        self.pause = min(2 * self.pause, LONGEST_PAUSE)
        return pause

    def _error(self, failed: Failed) -> Error:
        if isinstance(failed.error, Error):
            return failed.error
        if failed.sent and self.call.once:
            return Unreachable(
                f"cannot {self.call.method} {self.call.path}",
                f"{failed.error}, and it is not known whether it was done",
                "looking, then again",
                "unreachable",
            )
        return unreachable(self.where, failed.error)


# -- the calls -------------------------------------------------------------------------------------------------


def _query(path: str, **fields: Any) -> str:
    given = {k: str(v).lower() if isinstance(v, bool) else v for k, v in fields.items() if v is not None and v != ""}
    return f"{path}?{urlencode(given)}" if given else path


def _of(name: str) -> str:
    return quote(name, safe="")


def put_request(id: str, body: dict[str, Any], requester: str | None, wait: float | None = None) -> Call[RequestView]:
    """`wait`: the answer comes when the services are ready, or is NotReady; the request stands either way."""
    return Call("PUT", _query(f"/v1/requests/{_of(id)}", requester=requester), body, wait=wait)


def renew(id: str, requester: str | None) -> Call[RequestView]:
    return Call("POST", _query(f"/v1/requests/{_of(id)}/renew", requester=requester))


def release(id: str, requester: str | None, force: bool = True) -> Call[None]:
    return Call("DELETE", _query(f"/v1/requests/{_of(id)}", requester=requester, force=None if force else False))


def wait(services: Any, timeout: float) -> Call[dict[str, Any]]:
    check_names("wait", services)
    return Call("GET", f"/v1/wait?{urlencode([('services', s) for s in services])}", wait=timeout)


def requests() -> Call[list[RequestView]]:
    return Call("GET", "/v1/requests")


def services() -> Call[list[ServiceView]]:
    return Call("GET", "/v1/services")


def groups() -> Call[list[GroupView]]:
    return Call("GET", "/v1/groups")


def service(name: str) -> Call[ServiceView]:
    return Call("GET", f"/v1/services/{_of(name)}")


def why(name: str) -> Call[list[Why]]:
    return Call("GET", f"/v1/services/{_of(name)}/why")


def usage() -> Call[Usage]:
    return Call("GET", "/v1/usage")


def status() -> Call[dict[str, Any]]:
    return Call("GET", "/v1/status")


def plan() -> Call[dict[str, Any]]:
    return Call("GET", "/v1/plan")


def restart(name: str, force: bool) -> Call[list[str]]:
    return Call("POST", _query(f"/v1/services/{_of(name)}/restart", force=force or None), pick="services")


def hold(name: str, seconds: float, reason: str, force: bool) -> Call[list[str]]:
    body = {"duration": duration(seconds), "reason": reason, **({"force": True} if force else {})}
    return Call("PUT", f"/v1/holds/{_of(name)}", body, pick="services")


def unhold(name: str) -> Call[None]:
    return Call("DELETE", f"/v1/holds/{_of(name)}")


def suspend(seconds: float, reason: str) -> Call[None]:
    return Call("PUT", "/v1/suspension", {"duration": duration(seconds), "reason": reason})


def unsuspend() -> Call[None]:
    return Call("DELETE", "/v1/suspension")


def manifests() -> Call[list[ManifestView]]:
    return Call("GET", "/v1/manifests")


def manifest(kind: str, name: str) -> Call[str]:
    return Call("GET", f"/v1/manifests/{_of(kind)}/{_of(name)}")


def put_manifest(kind: str, name: str, text: str, base: str | None, message: str) -> Call[ManifestView]:
    return Call("PUT", f"/v1/manifests/{_of(kind)}/{_of(name)}", {"text": text, "base": base, "message": message})


def delete_manifest(kind: str, name: str, base: str, message: str) -> Call[None]:
    return Call("DELETE", _query(f"/v1/manifests/{_of(kind)}/{_of(name)}", base=base, message=message))


def events(
    cursor: int | None,
    follow: bool,
    tail: int,
    mine: bool,
    requester: str | None,
    only: Mapping[str, Any] | None = None,
) -> str:
    """The path of the events."""
    path = _query("/v1/events", cursor=cursor, follow=follow, tail=tail, mine=mine or None, requester=requester)
    more = {k: v for k, v in (only or {}).items() if v}
    return f"{path}&{urlencode(more, doseq=True)}" if more else path


def description(name: str) -> Call[list[dict[str, Any]]]:
    return Call("GET", f"/v1/services/{_of(name)}/description")


def logs(name: str, also: Sequence[str], after: Sequence[str], **lines: bool | int | str | None) -> str:
    """The path of the logs. `lines`: follow, tail, since, until, previous."""
    more = [("also", other) for other in also] + [("after", cursor) for cursor in after]
    path = _query(f"/v1/services/{_of(name)}/logs", **lines)
    return f"{path}&{urlencode(more)}" if more else path


# -- words -----------------------------------------------------------------------------------------------------


def duration(seconds: float) -> str:
    """A duration as rorg reads it."""
    return f"{seconds:.6f}".rstrip("0").rstrip(".") + "s"


def digest_of(found: list[ManifestView], kind: str, name: str) -> str | None:
    """The current digest of a manifest; None if there is none."""
    return next((m["digest"] for m in found if (m["kind"], m["name"]) == (kind, name)), None)


def manifest_text(kind: str, name: str, spec: dict[str, Any]) -> str:
    """A manifest as YAML."""
    lines = ["apiVersion: rorg/v1", f"kind: {kind}", f"metadata: {{name: {json.dumps(name)}}}", "spec:"]
    return "\n".join([*lines, *_block(spec, "  ")]) + "\n"


def _block(value: dict[str, Any], indent: str) -> list[str]:
    """A mapping in YAML's block style; other values are in JSON, which is valid YAML."""
    lines = []
    for key, found in value.items():
        if isinstance(found, dict) and found:
            lines += [f"{indent}{json.dumps(str(key))}:", *_block(found, indent + "  ")]
        else:
            lines.append(f"{indent}{json.dumps(str(key))}: {json.dumps(found)}")
    return lines
