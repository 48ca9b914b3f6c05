"""What commands ask of a robot: of the running rorg, or, where none serves, of this process, by the same rules."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from rorg.cli.output import consent
from rorg.errors import Unconfirmed

if TYPE_CHECKING:
    from rorg_client import Client
    from rorg_client.types import Why

    from rorg.cli.context import Context


T = TypeVar("T")


class Operating(Protocol):
    """Bodies are those of the API. Errors of the running rorg are those of its client, others RorgError."""

    def put_request(self, id: str, requester: str, body: dict[str, Any]) -> None:
        """Requests services."""

    def request(self, id: str, requester: str) -> dict[str, Any] | None:
        """A request as the API shows it; None where there is none."""

    def requesters(self, id: str) -> list[str]:
        """Who has a request of this id that can be released."""

    def release(self, id: str, requester: str, force: bool = True) -> None:
        """Gives a request up. Raises Unconfirmed, without `force`, where that stops what moves hardware, or takes
        something from a service that asked for it."""

    def restart(self, name: str, force: bool) -> list[str]:
        """Restarts a service, or each of a group; returns their names. Raises Unconfirmed."""

    def retry(self, names: list[str], force: bool) -> list[str]:
        """Tries changes of services again that failed; returns their names. Raises Unconfirmed."""

    def hold(self, body: dict[str, Any]) -> list[str]:
        """Holds services, or ends that; returns their names. Raises Unconfirmed."""

    def suspend(self, body: dict[str, Any] | None) -> None:
        """Suspends rorg; None ends that."""

    def why(self, name: str) -> list[Why]:
        """Why a service, or each of a group, is active, or why not."""

    def waiting(self, what: str) -> None:
        """Raises Unreachable where nobody runs who could bring about what is to be waited for."""

    def wait(self, names: list[str], timeout: float) -> None:
        """Returns when these services and all that they need are ready, and what was requested before is known;
        `timeout` in seconds."""


class Served:
    """By the running rorg."""

    def __init__(self, client: Client) -> None:
        self.client = client

    def put_request(self, id: str, requester: str, body: dict[str, Any]) -> None:
        from rorg_client import calls

        self.client.do(calls.put_request(id, body, requester))

    def request(self, id: str, requester: str) -> dict[str, Any] | None:
        known = (r for r in self.client.requests() if not r["standing"])
        found = next((r for r in known if (r["requester"], r["id"]) == (requester, id)), None)
        return dict(found) if found else None

    def requesters(self, id: str) -> list[str]:
        return [r["requester"] for r in self.client.requests() if r["id"] == id and not r["standing"]]

    def release(self, id: str, requester: str, force: bool = True) -> None:
        from rorg_client import calls

        with asking():
            self.client.do(calls.release(id, requester, force))

    def restart(self, name: str, force: bool) -> list[str]:
        self._addressable(name)
        with asking():
            return self.client.restart(name, force)

    def retry(self, names: list[str], force: bool) -> list[str]:
        # An rorg of before knows of no `force`, and is not told of it.
        body = {"services": names, **({"force": True} if force else {})}
        with asking():
            found: list[str] = self.client.call("POST", "/v1/retries", body)["services"]
            return found

    def hold(self, body: dict[str, Any]) -> list[str]:
        with asking():
            found: list[str] = self.client.call("PUT", "/v1/holds", body)["services"]
            return found

    def suspend(self, body: dict[str, Any] | None) -> None:
        self.client.call("PUT" if body else "DELETE", "/v1/suspension", body)

    def why(self, name: str) -> list[Why]:
        self._addressable(name)
        return self.client.why(name)

    def _addressable(self, name: str) -> None:
        """Raises Missing for a name that would make another address of a call's."""
        if not name or "/" in name:
            from rorg.api.current import missing

            services, groups = self.client.services(), self.client.groups()
            raise missing(name, {*(s["service"] for s in services), *(g["name"] for g in groups)})

    def waiting(self, what: str) -> None:
        pass

    def wait(self, names: list[str], timeout: float) -> None:
        with watched(self.client, names):
            self.client.wait(*names, timeout=timeout)


@contextmanager
def asking() -> Iterator[None]:
    """Raises Unconfirmed where the running rorg wants to be told once more."""
    from rorg_client import Refused

    try:
        yield
    except Refused as refused:
        if not refused.confirm:
            raise
        what = refused.what.removeprefix("cannot ")
        raise Unconfirmed(what, refused.cause, refused.remedy, refused.confirm) from refused


def confirmed(act: Callable[[bool], T], yes: bool, verb: str) -> T:
    """Does it; where others are affected only with consent: `--yes`, or that of the person at the terminal, who is
    told whom. Raises Refused."""
    try:
        return act(yes)
    except Unconfirmed as asked:
        consent(asked.what, f"{asked.why}. {verb}?", f"{asked.why}; it needs confirmation")
        return act(True)


def watched(client: Client, names: list[str]) -> AbstractContextManager[object]:
    """Shows a person at the terminal what is waited for while the block runs."""
    if not sys.stderr.isatty() or os.environ.get("TERM", "dumb") in ("dumb", "unknown"):
        return nullcontext()
    from rorg.cli.progress import Progress

    return Progress(client, names)


def operating(context: Context) -> Operating:
    """Whoever does what is asked of this robot."""
    client = context.client()
    if client:
        return Served(client)
    from rorg.cli.alone import Local

    return Local(context)
