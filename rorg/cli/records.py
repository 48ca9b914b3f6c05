"""What commands read of the history: from the running rorg, else from its file by the same queries."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import quote, urlencode

if TYPE_CHECKING:
    from rorg_client import Client

    from rorg.cli.context import Context
    from rorg.history.database import Database


class Records(Protocol):
    """Values are those of the API (rorg/api/history_models.py)."""

    def listed(self, most: int) -> list[dict[str, Any]]:
        """The newest revisions first."""

    def shown(self, rev: str) -> dict[str, Any]:
        """All of a revision."""

    def compared(self, a: str, b: str) -> dict[str, Any]:
        """What differs between two of them."""

    def timeline(self, service: str, since: str, until: str) -> dict[str, Any]:
        """What a service went through; times are ISO 8601."""

    def requested(self, since: str, until: str) -> dict[str, Any]:
        """What the robot was asked for; times are ISO 8601."""

    def measured(self, since: str) -> list[dict[str, Any]]:
        """What services used while they ran."""

    def everything(self) -> Iterator[dict[str, Any]]:
        """All that is on record."""


@contextmanager
def records_of(context: Context) -> Iterator[Records]:
    """For as long as the block runs. Raises Unreachable where no rorg runs and its files may not be read."""
    client = context.client() if context.state.readable else context.serving("read the history")
    if client:
        yield Served(client)
        return
    from rorg.history.database import reading

    with reading(context.state.journal) as database:
        yield Kept(context, database)


class Served:
    """By the running rorg."""

    def __init__(self, client: Client) -> None:
        self.client = client

    def listed(self, most: int) -> list[dict[str, Any]]:
        return list(self.client.call("GET", f"/v1/history?most={most}"))

    def shown(self, rev: str) -> dict[str, Any]:
        return dict(self.client.call("GET", f"/v1/history/{quote(rev)}"))

    def compared(self, a: str, b: str) -> dict[str, Any]:
        return dict(self.client.call("GET", f"/v1/history/{quote(a)}/diff/{quote(b)}"))

    def timeline(self, service: str, since: str, until: str) -> dict[str, Any]:
        asked = urlencode({"since": since, "until": until})
        return dict(self.client.call("GET", f"/v1/timeline/{quote(service, safe='')}?{asked}"))

    def requested(self, since: str, until: str) -> dict[str, Any]:
        return dict(self.client.call("GET", f"/v1/requested?{urlencode({'since': since, 'until': until})}"))

    def measured(self, since: str) -> list[dict[str, Any]]:
        return list(self.client.call("GET", f"/v1/measured?{urlencode({'since': since})}"))

    def everything(self) -> Iterator[dict[str, Any]]:
        from rorg_client.connection import Connection
        from rorg_client.errors import unreachable

        connection = None
        try:
            connection = Connection(self.client.address, self.client.timeout)
            lines = self.client.lines(connection, "/v1/history/export")
            next(lines)
            yield from map(dict, lines)
        except OSError as error:
            raise unreachable(str(self.client.address), error) from error
        finally:
            if connection:
                connection.close()


class Kept:
    """By what its file says."""

    def __init__(self, context: Context, database: Database) -> None:
        from rorg.history.journal import Journal
        from rorg.history.revisions import Revisions

        self.context, self.database = context, database
        self.journal, self.revisions = Journal(database), Revisions(database)

    def listed(self, most: int) -> list[dict[str, Any]]:
        from rorg.history.queries import listed

        return listed(self.revisions, most)

    def shown(self, rev: str) -> dict[str, Any]:
        from rorg.history.queries import full

        return full(self._named(rev))

    def compared(self, a: str, b: str) -> dict[str, Any]:
        from rorg.history.queries import compared

        return compared(self._named(a), self._named(b))

    def timeline(self, service: str, since: str, until: str) -> dict[str, Any]:
        from rorg.history.queries import timeline

        return timeline(self.journal, service, since, until)

    def requested(self, since: str, until: str) -> dict[str, Any]:
        """Up to the last entry at the most: nobody knows what is since."""
        from rorg.history.journal import Filter
        from rorg.history.request_log import requested

        last = next((entry["at"] for entry in self.journal.select(Filter(), 1, newest=True)), until)
        return requested(self.journal, since, min(until, last))

    def measured(self, since: str) -> list[dict[str, Any]]:
        from rorg.history.usage import UsageTable

        return UsageTable(self.database).since(since)

    def everything(self) -> Iterator[dict[str, Any]]:
        from rorg.history.queries import records

        return records(self.journal, self.revisions)

    def _named(self, rev: str) -> Any:
        from rorg.history.queries import resolve
        from rorg.host.git import commit_of

        return resolve(rev, self.revisions, lambda name: commit_of(self.context.root, name))
