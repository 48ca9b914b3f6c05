"""What commands read of the history: from the running rorg, or from its files by the same queries."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlencode

from rorg_client import Client
from rorg_client.errors import unreachable

from rorg.cli.context import Context

if TYPE_CHECKING:
    from rorg.history.database import Database


@contextmanager
def records_of(context: Context) -> Iterator[Served | Kept]:
    """Gives the history while the block runs. Raises Unreachable if no rorg runs and its files may not be read."""
    client = context.client() if context.state.readable else context.serving("read the history")
    if client:
        yield Served(client)
        return
    from rorg.history.database import reading

    with reading(context.state.journal) as database:
        yield Kept(context, database)


class Served:
    """The history of the running rorg. Values are those of the API (rorg/api/history_models.py); times are ISO 8601."""

    def __init__(self, client: Client) -> None:
        self.client = client

    def listed(self, most: int) -> list[dict[str, Any]]:
        """Revisions, the newest first."""
        return list(self.client.call("GET", f"/v1/history?most={most}"))

    def earlier(self, service: str) -> list[dict[str, Any]]:
        """Revisions that a rollback, of one service or of all, may return to, the newest first, each with the doubt
        about it."""
        return list(self.client.call("GET", f"/v1/rollback?{urlencode({'service': service})}"))

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

    def slots(self, since: str, until: str) -> list[dict[str, Any]]:
        """What the machine and its services used over time."""
        return list(self.client.call("GET", f"/v1/measured/slots?{urlencode({'since': since, 'until': until})}"))

    def everything(self) -> Iterator[dict[str, Any]]:
        from rorg_client.connection import Connection

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
    """The same, read from the files of a robot whose rorg does not run."""

    def __init__(self, context: Context, database: Database) -> None:
        from rorg.history import queries
        from rorg.history.journal import Journal
        from rorg.history.revisions import Revisions

        self.context, self.database, self.queries = context, database, queries
        self.journal, self.revisions = Journal(database), Revisions(database)

    def listed(self, most: int) -> list[dict[str, Any]]:
        return self.queries.listed(self.revisions, most)

    def earlier(self, service: str) -> list[dict[str, Any]]:
        return self.queries.earlier(self.database, service)

    def shown(self, rev: str) -> dict[str, Any]:
        return self.queries.full(self._named(rev))

    def compared(self, a: str, b: str) -> dict[str, Any]:
        return self.queries.compared(self._named(a), self._named(b))

    def timeline(self, service: str, since: str, until: str) -> dict[str, Any]:
        return self.queries.timeline(self.journal, service, since, until)

    def requested(self, since: str, until: str) -> dict[str, Any]:
        """At most up to the last entry: what happened later is unknown."""
        from rorg.history.journal import Filter
        from rorg.history.request_log import RequestLog

        last = next((entry["at"] for entry in self.journal.select(Filter(), 1, newest=True)), until)
        return RequestLog(self.journal).between(since, min(until, last))

    def measured(self, since: str) -> list[dict[str, Any]]:
        from rorg.history.usage import UsageTable

        return UsageTable(self.database).since(since)

    def slots(self, since: str, until: str) -> list[dict[str, Any]]:
        from rorg.history.usage import UsageTable

        return [slot._asdict() for slot in UsageTable(self.database).slots(since, until)]

    def everything(self) -> Iterator[dict[str, Any]]:
        return self.queries.records(self.journal, self.revisions)

    def _named(self, rev: str) -> Any:
        from rorg.host.git import commit_of

        return self.queries.resolve(rev, self.revisions, lambda name: commit_of(self.context.root, name))
