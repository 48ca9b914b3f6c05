"""rorg fleet"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rorg.cli.kinds import FILE, Seconds, durations
from rorg.cli.options import Output
from rorg.cli.output import print_rows
from rorg.errors import Invalid
from rorg.model.units import stamp
from rorg.store.files import make_directory, read_state, write_atomic

if TYPE_CHECKING:
    import ssl

AT_ONCE = 64
"""Robots that are asked at the same time."""
MOST = 10_000
"""Robots in a file."""
LONGEST = 300
"""Characters of one cell in the table."""
COLUMNS = ("name", "revision", "standing", "health", "drift", "answer")


def command(
    action: Annotated[Literal["status"], typer.Argument(help="status.")],
    file: Annotated[
        Path, typer.Argument(help="A YAML file with NAME: https://HOST:PORT for each robot.", click_type=FILE)
    ],
    *,
    timeout: Annotated[
        float, typer.Option(help="How long to wait for a robot: 2s.", parser=durations(0.1, 60))
    ] = Seconds(2),
    output: Output = "table",
) -> None:
    """List the robots of a fleet: the revision of their manifests and whether it works, the health of their services,
    drift, and since when a robot has not answered. The certificate is that of RORG_CA, RORG_CERT and RORG_KEY.

    Example: rorg fleet status robots.yaml
    """
    assert action == "status"
    addresses, ask = _addresses(file), partial(_ask, timeout=timeout, trusted=_certificates())
    with ThreadPoolExecutor(min(AT_ONCE, max(1, len(addresses)))) as pool:
        answers = dict(zip(addresses, pool.map(ask, addresses.values()), strict=True))
    seen = _seen(answers)
    full = [
        {"name": name, "address": addresses[name], **answer, "seen_at": seen.get(name, "")}
        for name, answer in answers.items()
    ]
    print_rows(
        [_short(_row(entry)) for entry in full], output, COLUMNS, ("address", "machine"), full=full, below=("answer",)
    )


def _addresses(file: Path) -> dict[str, str]:
    """Name -> address. Raises Invalid."""
    from rorg.manifest.yaml_source import read_yaml

    try:
        text = file.read_text(encoding="utf-8") if file.stat().st_size < MOST * 200 else ""
    except (OSError, UnicodeDecodeError) as error:
        raise Invalid(f"read {file}", getattr(error, "strerror", None) or str(error)) from error
    document, wrong = read_yaml(text, str(file))
    robots = document.value if document and isinstance(document.value, dict) else {}
    if not 0 < len(robots) <= MOST or not all(str(a).startswith("https://") for a in robots.values()):
        why = wrong[0].message if text and wrong else "it is no list of robots"
        raise Invalid(f"read {file}", why, "a line for each robot: `nora: https://nora:7878`")
    return {str(name): address for name, address in robots.items()}


def _certificates() -> ssl.SSLContext:
    """By what robots are known, and this person to them. Raises Invalid."""
    from rorg.host.bounded_http import trust

    authority, certificate, key = (os.environ.get(name) or None for name in ("RORG_CA", "RORG_CERT", "RORG_KEY"))
    try:
        return trust(authority, certificate, key)
    except OSError as error:
        why = f"the certificates cannot be read: {error}"
        raise Invalid("ask the robots", why, "RORG_CA, RORG_CERT and RORG_KEY") from error


def _ask(address: str, timeout: float, trusted: ssl.SSLContext) -> dict[str, Any]:
    """What a robot answers, or why that is no answer. It may be anything, and must not keep the others from being
    shown."""
    from rorg.api.peer import problem_of
    from rorg.api.status_models import SummaryView
    from rorg.host.bounded_http import HEAD, answer
    from rorg.host.deadline import Deadline

    try:
        with answer(f"{address.rstrip('/')}/v1/summary", Deadline.within(timeout), trusted=trusted) as response:
            status, content = response.status, response.read(HEAD)
        if status != 200:
            return {"error": problem_of(content, status)}
        return {**SummaryView.model_validate_json(content).model_dump(), "error": ""}
    except OSError as error:
        return {"error": getattr(error, "strerror", None) or str(error)}
    except Exception:
        return {"error": "answers what this version of rorg does not know"}


def _seen(answers: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """When each robot answered last, as far as this user has asked; kept for the next time."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local/state"
    path, known = Path(base) / "rorg/fleet.json", {}
    with contextlib.suppress(OSError, ValueError, AttributeError, TypeError):  # it is only a help
        known = {str(name): at for name, at in json.loads(read_state(path)).items() if datetime.fromisoformat(at)}
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
        note = f"{since}: {entry['error']}"
        return {**entry, "revision": "-", "standing": "-", "health": "-", "drift": "-", "answer": note}
    health = ", ".join(f"{count} {word}" for word, count in sorted(entry["health"].items()))
    notes = [entry["engine"], entry["reason"], ", ".join(entry["degraded"]), entry["down"]]
    return {**entry, "health": health or "idle", "answer": "; ".join(filter(None, notes)) or "ok"}


def _short(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value if len(text := str(value)) <= LONGEST else f"{text[:LONGEST]}…" for name, value in row.items()}


def _local(at: str) -> str:
    return datetime.fromisoformat(at).astimezone().strftime("%Y-%m-%d %H:%M")
