"""What a machine of a robot must still know after a restart: what it owns, and the leases of other machines."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from rorg.core.links import Renewal
from rorg.core.ownership import Owned
from rorg.core.received import is_within_bounds
from rorg.errors import Invalid
from rorg.model.catalog import Request
from rorg.store.files import read_state, write_atomic

NAME = "machine.json"


@dataclass(frozen=True, slots=True)
class Known:
    """The content of the file."""

    here: str = ""
    """The machine that this was; "" if the robot has only ever had one."""
    incarnation: int = 0
    """How often rorg has begun here."""
    owned: Owned = Owned()
    leases: Mapping[str, Renewal] = field(default_factory=dict)
    ahead: Mapping[str, int] = field(default_factory=dict)
    """Machine -> how much higher an incarnation it is told, because it knew a later one."""


def read(path: Path) -> Known:
    """Read the file; a missing one says nothing. Numbers and leases that no message may have are left out: the other
    machines say again what they know. Raises Invalid if it cannot be read: without it, rorg would not know which
    services may run here."""
    try:
        told = json.loads(read_state(path))
        owned = Owned(frozenset(map(str, told["owned"])), {str(n): str(m) for n, m in told["last"].items()})
        leases = {str(m): lease for m, said in told["leases"].items() if is_within_bounds(lease := _renewal(said))}
        ahead = {str(m): int(more) for m, more in told.get("ahead", {}).items() if is_within_bounds(more)}
        incarnation = int(told["incarnation"])
        return Known(str(told["here"]), incarnation if is_within_bounds(incarnation) else 0, owned, leases, ahead)
    except (FileNotFoundError, NotADirectoryError):
        return Known()
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise Invalid(
            f"read {path}",
            f"it does not say which services this machine owns ({type(error).__name__}: {error})",
            "to remove it; each service then waits until the other machines have confirmed that it does not run there",
        ) from error


def write(path: Path, known: Known) -> None:
    """Replace the file, and wait for the disk. Raises OSError."""
    told = {
        "here": known.here,
        "incarnation": known.incarnation,
        "owned": sorted(known.owned.owned),
        "last": dict(sorted(known.owned.last.items())),
        "ahead": dict(sorted(known.ahead.items())),
        "leases": {machine: _plain(renewal) for machine, renewal in sorted(known.leases.items())},
    }
    write_atomic(path, json.dumps(told, indent=1) + "\n")


def _plain(renewal: Renewal) -> dict[str, Any]:
    plain = {f.name: getattr(renewal, f.name) for f in fields(renewal)}
    requests = [{k: v for k, v in asdict(r).items() if k != "where"} for r in renewal.requests]
    return {**plain, "excluded": dict(renewal.excluded), "requests": requests}


def _renewal(plain: Any) -> Renewal:
    requests = tuple(Request(**{**r, "services": tuple(r["services"])}) for r in plain["requests"])
    asking = tuple((str(name), float(since)) for name, since in plain["asking"])
    return Renewal(**{**plain, "requests": requests, "asking": asking, "takes": tuple(plain["takes"])})
