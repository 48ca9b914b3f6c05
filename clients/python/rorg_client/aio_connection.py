"""One connection of the asyncio client."""

from __future__ import annotations

import asyncio
import json
import os
import socket
from typing import AsyncIterator, TypeVar

from rorg_client.address import Address
from rorg_client.errors import problem
from rorg_client.types import Event
from rorg_client.wire import LINE, Reading, asking, reading_body, reading_chunk, reading_head

T = TypeVar("T")


class AsyncConnection:
    """A connection. Every failure is an OSError."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        self._late = False

    @classmethod
    async def open(cls, address: Address, timeout: float) -> AsyncConnection:
        if address.host:
            opening = asyncio.open_connection(
                address.host, address.port, ssl=address.tls(), server_hostname=address.host
            )
            try:
                return cls(*await asyncio.wait_for(opening, timeout))
            except asyncio.TimeoutError:
                raise TimeoutError(f"no connection within {timeout:g} s") from None
        found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            found.setblocking(False)
            name, folder = address.place()
            try:
                found.connect(name)  # immediately, or not at all
            finally:
                if folder is not None:
                    os.close(folder)
            return cls(*await asyncio.open_unix_connection(sock=found))
        except BaseException:
            found.close()
            raise

    async def ask(self, data: bytes, reading: Reading[T], timeout: float) -> T:
        """Sends a request and reads the answer, within a number of seconds."""
        timer = asyncio.get_running_loop().call_later(timeout, self._time_out)
        try:
            self._writer.write(data)
            await self._writer.drain()
            return await self.drive(reading)
        except OSError:
            if self._late:
                raise TimeoutError(f"no answer within {timeout:g} s") from None
            raise
        finally:
            timer.cancel()

    def _time_out(self) -> None:
        self._late = True
        self._writer.transport.abort()

    async def drive(self, reading: Reading[T]) -> T:
        """Feeds a reader until it has everything."""
        try:
            wanted = next(reading)
            while True:
                wanted = reading.send(await self._read(wanted))
        except StopIteration as done:
            found: T = done.value
            return found

    async def _read(self, wanted: int) -> bytes:
        if wanted == LINE:
            return await self._reader.readline()
        try:
            return await self._reader.readexactly(wanted)
        except asyncio.IncompleteReadError as error:
            return error.partial

    def close(self) -> None:
        self._writer.transport.abort()


async def events_of(connection: AsyncConnection, path: str) -> AsyncIterator[Event]:
    """Events of one connection; the first one has only the number where the stream begins."""
    head = await connection.ask(asking("GET", path, None, {}), reading_head(), 30.0)
    if head[0] != 200:
        raise problem(head[0], await connection.drive(reading_body(head)))
    yield {"seq": int(head[1].get("rorg-cursor") or 0)}  # type: ignore[typeddict-item]
    rest = b""
    while True:
        piece = await connection.drive(reading_chunk())
        if not piece:
            return
        *whole, rest = (rest + piece).split(b"\n")
        for line in whole:
            yield json.loads(line)
