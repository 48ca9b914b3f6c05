"""Signals to a container's processes, and waiting for their effect."""

from __future__ import annotations

import signal
import time

from rorg.engines.process.records import Record, Records
from rorg.engines.process.table import members, signal_group
from rorg.engines.protocol import stop_sequence
from rorg.errors import EngineError
from rorg.model.signals import signal_number


def send(record: Record, number: int) -> bool:
    """Send a signal to all its processes; False if none is left."""
    return bool(record.get("pid")) and signal_group(
        record["pid"], record["ticks"], record["boot"], record["id"], number
    )


def switch(records: Records, record: Record, verb: str, number: int, before: str, after: str) -> None:
    """Send a signal that changes the state of a container, and return when it has changed. Raises EngineError
    (conflict)."""
    if (now := records.state(record)[0]) != before:
        raise EngineError(f"{verb} {record['name']}", f"it is {now}, not {before}", kind="conflict")
    send(record, number)
    deadline = time.monotonic() + 2.0
    while (now := records.state(record)[0]) != after:
        if now == "exited" or time.monotonic() > deadline:
            raise EngineError(f"have {record['name']} {after}", f"it is {now}", kind="conflict")
        time.sleep(0.002)


def end(records: Records, record: Record, name: str, grace: float) -> None:
    """End a run. A stopped group receives signals only when it continues: so first the signal, then SIGCONT. A signal
    that the kernel does not have is skipped. Raises EngineError if it still runs at the end."""
    for step, seconds in stop_sequence(name, grace):
        try:
            number = signal_number(step)
        except ValueError:
            continue
        if not send(record, number):
            return
        send(record, signal.SIGCONT)
        if _ended(records, record, seconds):
            return
    raise EngineError(f"stop {record['name']}", "it did not end after SIGKILL", "`dmesg` for a device that hangs")


def _ended(records: Records, record: Record, seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if records.state(record)[0] == "exited" and not members(record["pid"], record["id"]):
            return True
        time.sleep(0.005)
    return False
