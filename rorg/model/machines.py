"""The computers of a robot."""

from __future__ import annotations

from dataclasses import dataclass

from rorg.model.diagnostics import Where

SHORTEST_LEASE, LONGEST_LEASE = 10.0, 30.0
"""Seconds. A shorter lease would end in a machine that is busy for a moment; a longer one would keep unused programs
running."""
PORT = 7878
MACHINE = "RORG_MACHINE"
"""The variable that names the machine; `rorg run --machine` sets it."""
ANYWHERE = "any"
"""The machine of services that may run on any node of a Docker Swarm. Its rorg has the Swarm as its engine."""


@dataclass(frozen=True, slots=True)
class Machine:
    """One computer of the robot, with an rorg of its own."""

    name: str
    address: str
    """HOST:PORT of its rorg, for the other machines."""
    certificate: str = ""
    """The common name of its TLS certificate."""
    lease: float = 15.0
    """Seconds for which requests of other machines count here without being renewed."""
    default: bool = False
    """Services that name no machine belong to it."""
    where: Where = Where("")
