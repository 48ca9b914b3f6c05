"""Runs in the guest, for tests/assurance/vm/cuts.py: puts and releases requests at random until the power is cut. It
prints `["asks", ID, REASON]` before each call and `["has", ID, REASON]` when the call is acknowledged; for a release,
the reason is null."""

from __future__ import annotations

import json
import random
import sys

from rorg.client import Client

SERVICES = ("arm", "camera", "hoarder")


def say(*words: str | None) -> None:
    print(json.dumps(words), flush=True)


def main() -> None:
    mark, client, dice = sys.argv[1], Client("/run/rorg/rorg.sock", patience=60.0), random.Random()
    for number in range(1_000_000):
        id = f"c{dice.randrange(8)}"
        reason = f"{mark}-{number}" if dice.random() < 0.6 else None
        say("asks", id, reason)
        if reason:
            wanted = dice.sample(SERVICES, dice.randint(1, len(SERVICES)))
            client.call("PUT", f"/v1/requests/{id}", {"services": wanted, "reason": reason})
        else:
            client.release(id)
        say("has", id, reason)


main()
