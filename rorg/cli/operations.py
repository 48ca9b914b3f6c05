"""What commands ask of a robot: of the running rorg, or of this process (offline.py) if none serves."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any, TypeVar

from rorg_client import Client, Refused
from rorg_client.calls import Call, put_request, release, restart

from rorg.cli.context import Context
from rorg.cli.interlocks import locked
from rorg.cli.output import consent
from rorg.cli.progress import Progress
from rorg.errors import Unconfirmed

if TYPE_CHECKING:
    from rorg_client.types import Why

    from rorg.cli.offline import Local

T = TypeVar("T")


class Served:
    """What commands ask of the running rorg. Bodies are those of the API; errors are those of the client."""

    def __init__(self, client: Client) -> None:
        self.client = client

    def put_request(self, id: str, requester: str, body: dict[str, Any]) -> None:
        self.client.do(put_request(id, body, requester))

    def requests(self, id: str) -> list[dict[str, Any]]:
        """The requests with this id that can be released, as the API shows them."""
        return [dict(r) for r in self.client.requests() if r["id"] == id and not r["standing"]]

    def release(self, id: str, requester: str, force: bool = True) -> None:
        self._do(release(id, requester, force))

    def restart(self, name: str, force: bool) -> list[str]:
        """Restarts a service, or each of a group; their names. Raises Unconfirmed."""
        self._addressable(name)
        return self._do(restart(name, force))

    def change(self, call: str, body: dict[str, Any], force: bool) -> list[str]:
        """Does one of the OPERATIONS of rorg/api/changes.py; the names of its services. Raises Unconfirmed."""
        method, path = call.split()
        # An older rorg refuses the field `force` of some calls.
        return self._do(Call(method, path, body | ({"force": True} if force else {}), "services"))

    def suspend(self, body: dict[str, Any] | None) -> None:
        """Suspends rorg; None ends that."""
        self.client.call("PUT" if body else "DELETE", "/v1/suspension", body)

    def locked(self) -> dict[str, str]:
        """The services that wait for their interlock -> its answer."""
        return locked(self.client.status())

    def why(self, name: str) -> list[Why]:
        self._addressable(name)
        return self.client.why(name)

    def check_wait(self, what: str) -> None:
        """Raises Unreachable if no rorg runs that could start the service to wait for; here one runs."""

    def wait(self, names: list[str], timeout: float) -> None:
        """Returns when these services and all that they need are ready, `timeout` in seconds."""
        with watched(self.client, names):
            self.client.wait(*names, timeout=timeout)

    def _do(self, call: Call[T]) -> T:
        """Makes a call. Raises Unconfirmed if rorg asks for confirmation."""
        try:
            return self.client.do(call)
        except Refused as refused:
            if not refused.confirm:
                raise
            what = refused.what.removeprefix("cannot ")
            raise Unconfirmed(what, refused.cause, refused.remedy, refused.confirm) from refused

    def _addressable(self, name: str) -> None:
        """Raises Missing for a name that would change the address of a call."""
        if not name or "/" in name:
            from rorg.api.current import missing

            services, groups = self.client.services(), self.client.groups()
            raise missing(name, {*(s["service"] for s in services), *(g["name"] for g in groups)})


def confirmed(act: Callable[[bool], T], yes: bool, verb: str) -> T:
    """Calls `act(force)`. If it affects drivers or other services, it needs `--yes`, or the person at the terminal, who
    sees which ones, must agree. Raises Refused."""
    try:
        return act(yes)
    except Unconfirmed as asked:
        consent(asked.what, f"{asked.why}. {verb}?", f"{asked.why}; it needs confirmation")
        return act(True)


def watched(client: Client, names: list[str]) -> AbstractContextManager[object]:
    """Shows what is not ready yet on the terminal while the block runs."""
    if not sys.stderr.isatty() or os.environ.get("TERM", "dumb") in ("dumb", "unknown"):
        return nullcontext()
    return Progress(client, names)


def operating(context: Context) -> Served | Local:
    """What commands ask of this robot: of the running rorg, or of this process if none serves."""
    client = context.client()
    if client:
        return Served(client)
    from rorg.cli.offline import Local

    return Local(context)
