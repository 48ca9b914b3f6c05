"""A behaviour: it drives while everything that it needs is ready, and stops immediately when something is not."""

from __future__ import annotations

import sys

import rorg_client as rorg


def drive(held: rorg.Request) -> None:
    """Stands for the work; ends early when something is lost."""
    if held.lost.wait(timeout=0.2):
        loss = held.losses[0]
        print(f"stopped: {loss.service} was {loss.cause}: {loss.reason}")
        held.wait(timeout=30)  # it may come back


def main(*services: str) -> None:
    try:
        with rorg.request(*services, wait=30, reason="tour") as held:
            for name, told in held.readiness().items():
                print(f"{name}: {'ready' if told['ready'] else told['reason']}")
            drive(held)
    except rorg.NotReady as error:
        sys.exit(f"no tour: {error.cause}")


if __name__ == "__main__":
    main(*sys.argv[1:])
