"""rorg logs"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Any, Literal

import typer
from rorg_client import Client, Error, Unreachable, calls
from rorg_client.errors import unreachable

from rorg.cli.context import Context
from rorg.cli.kinds import service_name
from rorg.cli.names import complete_services
from rorg.cli.options import RobotEngine
from rorg.cli.output import as_json, echo, missing, note
from rorg.cli.terminal import LogText
from rorg.errors import Invalid

AGAIN = 0.3
"""Seconds until the next attempt, when following and rorg does not answer."""

Services = Annotated[
    list[str] | None,
    typer.Argument(
        help="Services or groups. Default: everything that runs.",
        parser=service_name,
        autocompletion=complete_services,
    ),
]


def command(
    context: RobotEngine,
    services: Services = None,
    *,
    follow: Annotated[bool, typer.Option("-f", "--follow", help="Follow new lines.")] = False,
    tail: Annotated[int | None, typer.Option("-n", "--tail", help="Only the last lines of each: 100.", min=0)] = None,
    since: Annotated[str, typer.Option(help="Only lines since 10m (ago), or 2026-01-31T12:00:00Z.")] = "",
    until: Annotated[str, typer.Option(help="Only lines before this time, in the form of --since.")] = "",
    previous: Annotated[
        bool, typer.Option("-p", "--previous", help="Only lines from before the current run, such as those of a crash.")
    ] = False,
    timestamps: Annotated[bool, typer.Option("-t", "--timestamps", help="Show when each line was printed.")] = False,
    output: Annotated[Literal["table", "json"], typer.Option("-o", "--output", help="table or json.")] = "table",
) -> None:
    """Print the logs of services, merged by time. The process engine keeps no times: there, earlier lines come one
    service after the other, `--since`, `--until` and `--previous` are refused, and `-t` shows when rorg saw a followed
    line.

    Example: rorg logs navigation localization -f --since 10m
    """
    asked = {"follow": follow, "tail": tail, "since": since or None, "until": until or None, "previous": previous}
    client = context.client()
    names = list(dict.fromkeys(services or _running(context, client)))
    if client:
        members = {m for name in names for m in _members(client, name)}
        entries = _served(client, names, asked)
    else:
        members, entries = _here(context, names, asked)
    shown = Lines(sorted(members), timestamps) if output == "table" else None
    try:
        for entry in entries:
            _show(entry, shown)
    finally:
        if shown:
            shown.end()


def _running(context: Context, client: Client | None) -> list[str]:
    """Everything that runs. Raises Invalid if nothing does."""
    if client:
        names = [s["service"] for s in client.services() if s["incarnation"]]
    else:
        names = sorted({c.service for c in context.engine().list() if c.alive})
    if not names:
        raise Invalid("read logs", "nothing runs", "`rorg logs SERVICE` for one that ran")
    return names


def _show(entry: dict[str, Any], shown: Lines | None) -> None:
    """Shows one LogView."""
    if "error" in entry:
        note(f"{entry['service']}: {entry['error']}" if entry["service"] else entry["error"])
    elif shown and "text" in entry:
        shown.show(entry)
    elif "text" in entry:
        text = entry["text"].encode("utf-8", errors="surrogateescape").decode("utf-8", errors="backslashreplace")
        echo(as_json({"service": entry["service"], "time": entry.get("time"), "text": text.removesuffix("\n")}))


def _members(client: Client, name: str) -> Sequence[str]:
    return next((g["services"] for g in client.groups() if g["name"] == name), [name])


def _served(client: Client, names: Sequence[str], asked: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Lines from the running rorg; when following, also from the next one, without gaps."""
    from rorg_client.connection import Connection

    known: dict[str, str] = {}
    while True:
        connection = None
        try:
            connection = Connection(client.address, None if asked["follow"] else client.timeout)
            after = [f"{name}:{cursor}" for name, cursor in known.items()]
            lines = client.lines(connection, calls.logs(names[0], names[1:], **asked, after=after))
            next(lines)
            for line in lines:
                entry: dict[str, Any] = dict(line)
                if "cursor" in entry:
                    known[entry["service"]] = entry["cursor"]
                yield entry
            if not asked["follow"]:
                return
        except (OSError, Unreachable) as error:
            if not asked["follow"]:
                raise error if isinstance(error, Error) else unreachable(str(client.address), error) from error
        finally:
            if connection:
                connection.close()
        time.sleep(AGAIN)


def _here(context: Context, names: Sequence[str], asked: dict[str, Any]) -> tuple[set[str], Iterator[dict[str, Any]]]:
    """(services, lines) read by this process, if no rorg runs."""
    from rorg.api.logs import Selection, asked_for, has_log
    from rorg.core.observed import Container, Observed

    catalog, engine = context.catalog(), context.engine()
    for name in names:
        if not catalog.members(name):
            raise missing("service", name, {*catalog.services, *catalog.groups})
    services = list(dict.fromkeys(m for n in names for m in catalog.members(n) if not catalog.services[m].meta))

    def find(service: str) -> Container | None:
        return next(iter(Observed(tuple(engine.list())).by_service().get(service, [])), None)

    wanted = asked_for(services, Selection(**asked))
    has_log(names, wanted, find)
    return set(services), _read(engine, find, wanted)


def _read(engine: Any, find: Any, asked: Any) -> Iterator[dict[str, Any]]:
    from threading import Event

    from rorg.api.logs import entry_json
    from rorg.engines.logs import gather

    news = Event()
    entries = gather(engine, find, asked, news.set)
    try:
        while True:
            news.wait()
            news.clear()
            batch, over = entries.take()
            yield from map(entry_json, batch)
            if over and not batch:
                return
            if over:
                news.set()
    finally:
        entries.end()


class Lines:
    """Prints lines for people: with several services, each has its name in front. Of one service, a pipe or file gets
    the bytes unchanged; a terminal gets only lines and colours."""

    def __init__(self, services: Sequence[str], timestamps: bool) -> None:
        self.timestamps, self.terminal = timestamps, sys.stdout.isatty()
        several = len(services) > 1
        width = max(map(len, services), default=0)
        coloured = self.terminal and "NO_COLOR" not in os.environ and os.environ.get("TERM", "dumb") != "dumb"
        self.heads = {
            name: _coloured(f"{name:<{width}} | ", index) if coloured else f"{name:<{width}} | "
            for index, name in enumerate(services if several else ())
        }
        self.texts = {name: LogText() for name in services} if self.terminal else {}
        self.last = ("", True)
        """(service of the last line, whether the line has ended)."""

    def show(self, entry: dict[str, Any]) -> None:
        """Prints a line, or the rest of the last line if that has not ended and is of the same service."""
        name, text = entry["service"], entry["text"].encode("utf-8", errors="surrogateescape")
        before, ended = self.last
        head = b"" if ended or not self.heads else b"\n"
        if ended or before != name:
            time = f"{entry.get('time') or '-':<30} " if self.timestamps else ""
            head += (self.heads.get(name, "") + time).encode()
        else:
            head = b""
        if self.terminal and name in self.texts:
            text = self.texts[name].text(text, end=bool(self.heads)).encode()
        self.last = name, entry["text"].endswith("\n")
        _write([head, text])

    def end(self) -> None:
        """Resets colours, and ends the last line if several services were shown."""
        rest = [log.text(b"", end=True).encode() for log in self.texts.values()][:1]
        _write([*rest, b"" if self.last[1] or not self.heads else b"\n"])


def _write(pieces: Iterable[bytes]) -> None:
    sys.stdout.buffer.write(b"".join(pieces))
    sys.stdout.buffer.flush()


def _coloured(text: str, index: int) -> str:
    return f"\033[{(36, 33, 32, 35, 34, 31)[index % 6]}m{text}\033[0m"
