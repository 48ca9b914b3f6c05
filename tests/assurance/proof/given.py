"""How scenarios are written: services with probes, worlds that are made before any kill, and the list of all."""

from __future__ import annotations

from typing import Any

from proof.acts import Acts as World
from proof.cases import Scenario, Step

PROBE = {"exec": ["sh", "-c", "true"], "interval": "100ms", "timeout": "2s"}
NO = {"exec": ["sh", "-c", "false"], "interval": "100ms", "timeout": "200ms"}
SCENARIOS: dict[str, Scenario] = {}


def service(**spec: Any) -> dict[str, Any]:
    """A service with a probe, whose changes are proven soon."""
    return {"ready": PROBE, "update": {"bake": "100ms"}, **spec}


def always(**spec: Any) -> dict[str, Any]:
    return service(always_on=True, **spec)


def edition(number: int) -> dict[str, Any]:
    """Options that make another container."""
    return {"container": {"environment": {"EDITION": str(number)}}}


def declared(**services: dict[str, Any]) -> Step:
    return lambda world: world.declare(services)


def running(*names: str) -> Step:
    return lambda world: world.until(**dict.fromkeys(names, "running"))


def settled(*first: Step) -> Step:
    """A world in which rorg has run until nothing was left to do."""

    def given(world: World) -> None:
        declare, *rest = first
        declare(world)
        world.start()
        for step in rest:
            step(world)
        world.rest()

    return given


def scenario(name: str, given: Step, *steps: Step, ends: bool = False, command: bool = False) -> None:
    SCENARIOS[name] = Scenario(name, given, steps, ends, command)


BASE, ARM = always(), always(needs=["base"])
