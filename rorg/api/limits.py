"""The limits of the server, in one table, and what it counts of each caller. Pure, without I/O or clock. The reference
of the API is generated from this file."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rorg.api.permissions import Caller
from rorg.errors import TooMany

MOST_HEAD = 32 << 10
"""Bytes of a request's first line and headers (300 names to wait for fit); more gets 431."""
MOST_HEADERS = 64
"""Headers of a request; more gets 431."""
MOST_BODY = 1 << 20
"""Bytes of a body, which must declare its length; more gets 413."""
MOST_DROPPED = 16 << 20
"""Bytes of a refused body that are still read, so that its sender sees the reason before the connection is closed."""
MOST_PIPELINED = 4
"""Requests of a connection that wait for the one being answered; one more, and the connection is closed."""
IDLE = 60.0
"""Seconds after which an idle connection is closed."""
COMPLETE = 30.0
"""Seconds from a request's first byte to its last; after that its connection is closed."""
DEAF = 30.0
"""Seconds that an answer may wait to be read before its connection is closed; readers of events connect again."""
HANDSHAKE = 10.0
"""Seconds of a TLS handshake."""
MOST_HANDSHAKES = 64
"""TLS handshakes at the same time; one more ends the one that has taken longest."""
MOST_CONNECTIONS = 4000
"""Connections in total, over all sockets; fewer if this process may have fewer files open."""
RESERVED = 512
"""Descriptors that no connection takes, for the loop: containers, probes, files. Half of them if there are fewer than
1024."""
MOST_OF_ONE = 200
"""Connections of one service. No caller gets more than half of the room that is left, people included. A caller with
that many gets a new one by losing the one of its own that has been idle for longest, if any is idle."""
MOST_HELD = 4 << 20
"""Bytes of one service's bodies that are being read, and also of answers that it does not read."""
MOST_LOGS = 64
"""Logs of services that are read at the same time, each by a thread; of all callers."""
MOST_EXPORTS = 4
"""Exports of the history that are written at the same time, each by a thread; of all callers."""
MOST_REVISIONS = 1000
"""Revisions in one answer."""
SHARE = 0.2
"""CPU seconds per second that a service's calls may cost; after that, 429 and Retry-After. People have no such limit:
a person who can stop rorg has no need to flood it."""
BURST = 4.0
"""CPU seconds that a service may save up: 600 changes in a burst, then 30 a second; 10,000 looks at a service, then 500
a second. A behaviour that requests and releases hundreds of times in a row never waits."""
MOST_OWED = 0.4
"""CPU seconds that a service may owe: it never waits longer than 2.25 s."""
CALL = 0.0003
"""CPU seconds that any call costs besides its work: in the kernel, and because the loop waits meanwhile."""
CHANGE = 0.004
"""CPU seconds that a change costs besides those of its call: it is written to the disk, and the loop makes a pass."""
WAIT = 0.005
"""CPU seconds that a wait costs: the loop makes a pass, and probes run again."""
GREETING = 0.0005
"""CPU seconds that a connection costs before its first request."""
SPARE = 0.05
"""CPU seconds that a service must have saved up again before it is heard, once it has used all."""

UNLIMITED = math.inf


def room(descriptors: int) -> int:
    """Connections in total, if the process may have this many descriptors."""
    return min(MOST_CONNECTIONS, descriptors - min(RESERVED, descriptors // 2))


class Account:
    """What one caller uses of the server. `clock` gives monotonic seconds."""

    def __init__(self, name: str, share: float, clock: Callable[[], float]) -> None:
        self.name, self.share, self.clock = name, share, clock
        self.connections = self.bodies = self.unread = 0
        self.threads = asyncio.Lock()
        self.idle: dict[object, Callable[[], None]] = {}
        """Idle connections, each with a function that closes it; the one that has been idle for longest comes first."""
        self.closed = False
        """It belongs to a service whose socket is gone."""
        self._left, self._at, self._resting = BURST, clock(), False

    @property
    def limited(self) -> bool:
        return self.share != UNLIMITED

    def charge(self, seconds: float) -> None:
        """Charges the caller for CPU seconds."""
        if self.limited:
            now = self.clock()
            self._left = max(-MOST_OWED, min(BURST, self._left + (now - self._at) * self.share) - seconds)
            self._at = now

    def owed(self) -> float:
        """Seconds until the caller may call again; 0 if it may now."""
        self.charge(0.0)
        self._resting = self._left < (SPARE if self._resting else 0.0)
        return (SPARE - self._left) / self.share if self._resting else 0.0

    @property
    def unused(self) -> bool:
        """Whether it is as good as a new one."""
        self.charge(0.0)
        return not self.connections and self._left == BURST

    def fits(self, left: int) -> bool:
        """Whether it may have one more connection, if there is room for `left` more in total."""
        return self.connections < (min(MOST_OF_ONE, left) if self.limited else left)

    def make_room(self) -> bool:
        """Closes the connection that has been idle for longest, to make room for a new one; whether there was any."""
        oldest = next(iter(self.idle), None)
        if oldest is not None:
            self.idle.pop(oldest)()
        return oldest is not None

    @contextmanager
    def reading(self, length: int) -> Iterator[None]:
        """Counts a body of this length while it is read and answered. Raises TooMany."""
        if self.limited and self.bodies + length > MOST_HELD:
            raise TooMany(
                "read the request", f"{self.name} is already sending {self.bodies} bytes", "again in a moment"
            )
        self.bodies += length
        try:
            yield
        finally:
            self.bodies -= length


class Accounts:
    """The accounts of all callers since the start: a caller that reconnects keeps its account. That of a service that
    is gone is kept until it would have saved up as much as a new one has."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.clock = clock
        self._found: dict[str, Account] = {}

    def of(self, caller: Caller) -> Account:
        return self._one(caller.identity, UNLIMITED if caller.kind == "developer" else SHARE)

    def of_service(self, name: str) -> Account:
        account = self._one(name, SHARE)
        account.closed = False
        return account

    def _one(self, name: str, share: float) -> Account:
        if name not in self._found:
            self._found = {n: a for n, a in self._found.items() if not (a.closed and a.unused)}
            self._found[name] = Account(name, share, self.clock)
        return self._found[name]
