"""rorg fleet"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

from rorg_client import Client, Error

from rorg.cli.options import FILES, Argument, Option, Output, duration
from rorg.cli.output import print_rows
from rorg.errors import Invalid
from rorg.model.units import stamp
from rorg.store.files import make_directory, read_state, write_atomic

AT_ONCE = 64
"""Robots that are asked at the same time."""
MOST = 10_000
"""Robots in a file."""
COLUMNS = ("name", "revision", "standing", "health", "drift", "answer")


def command(
    action: Annotated[str, Argument("status.", choices=("status",))],
    file: Annotated[Path, Argument("A YAML file with NAME: https://HOST:PORT for each robot.", completes=FILES)],
    *,
    timeout: Annotated[float, Option("How long to wait for a robot: 2s.", parser=duration, least=0.1, most=60)] = 2.0,
    output: Output = "table",
) -> None:
    """List the robots of a fleet: the revision of their manifests and whether it works, the health of their services,
    drift, and since when a robot has not answered. The certificate is that of RORG_CA, RORG_CERT and RORG_KEY.

    Example: rorg fleet status robots.yaml
    """
    assert action == "status"
    addresses = _addresses(file)
    with ThreadPoolExecutor(min(AT_ONCE, max(1, len(addresses)))) as pool:
        answers = dict(zip(addresses, pool.map(lambda a: _ask(a, timeout), addresses.values()), strict=True))
    seen = _seen(answers)
    full = [
        {"name": name, "address": addresses[name], **answer, "seen_at": seen.get(name, "")}
        for name, answer in answers.items()
    ]
    print_rows([_row(entry) for entry in full], output, COLUMNS, ("address", "machine"), full=full, below=("answer",))


def _addresses(file: Path) -> dict[str, str]:
    """Name -> address. Raises Invalid."""
    import yaml

    try:
        told = yaml.safe_load(file.read_text(encoding="utf-8")) if file.stat().st_size < MOST * 200 else None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise Invalid(f"read {file}", getattr(error, "strerror", None) or str(error)) from error
    robots = told if isinstance(told, dict) else {}
    if not 0 < len(robots) <= MOST or not all(str(a).startswith("https://") for a in robots.values()):
        raise Invalid(f"read {file}", "it is no list of robots", "a line for each robot: `nora: https://nora:7878`")
    return {str(name): address for name, address in robots.items()}


def _ask(address: str, timeout: float) -> dict[str, Any]:
    """What a robot answers, or why it does not."""
    try:
        client = Client(address, timeout=timeout, patience=0.0)
        try:
            return {**client.call("GET", "/v1/summary"), "error": ""}
        finally:
            client.close()
    except Error as error:
        return {"error": error.cause or str(error)}


def _seen(answers: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """When each robot answered last, as far as this user has asked; kept for the next time."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state"
    path, known = Path(base) / "rorg/fleet.json", {}
    with contextlib.suppress(OSError, ValueError, AttributeError):  # it is only a help
        known = {str(name): str(at) for name, at in json.loads(read_state(path)).items()}
    now = stamp(time.time())
    known |= {name: now for name, answer in answers.items() if not answer["error"]}
    with contextlib.suppress(OSError):
        make_directory(path.parent)
        write_atomic(path, json.dumps(known, indent=1) + "\n", durable=False)
    return known


def _row(entry: Mapping[str, Any]) -> dict[str, Any]:
    if entry["error"]:
        at = entry["seen_at"]
        since = f"unreachable since {_local(at)}" if at else "never reached"
        return {**entry, "revision": "-", "standing": "-", "health": "-", "drift": "-", "answer": since}
    health = ", ".join(f"{count} {word}" for word, count in sorted(entry["health"].items()))
    notes = [entry["engine"], entry["reason"], ", ".join(entry["degraded"]), entry["down"]]
    return {**entry, "health": health or "idle", "answer": "; ".join(filter(None, notes)) or "ok"}


def _local(at: str) -> str:
    return datetime.fromisoformat(at).astimezone().strftime("%Y-%m-%d %H:%M")
