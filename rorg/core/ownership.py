"""Which services this machine may start, when its robot has several: only those that it owns.

A service belongs to the machine that its manifest names. Manifests reach machines at different times, so this is not
enough: a machine takes a service over only when every other one has confirmed that the service does not run there and
that its own manifests give it to another machine. Until then the service waits, and a person may confirm instead.

Two machines never own the same service. Each confirmation answers a question that was asked while the asker's manifests
already gave it the service; and a machine that confirms has first given the service up, on disk.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from rorg.core.links import Answer


@dataclass(frozen=True, slots=True)
class Owned:
    """What this machine owns, and what it is about to take over. `owned` and `last` are on disk before anything is done
    because of them."""

    owned: frozenset[str] = frozenset()
    last: Mapping[str, str] = field(default_factory=dict)
    """Service -> the machine that last owned it, as far as known here."""
    asked: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Service to take over -> machine -> number of the first renewal that can have asked for it."""
    confirmed: Mapping[str, frozenset[str]] = field(default_factory=dict)
    """Service to take over -> machines that have confirmed."""
    kept: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """Service to take over -> machine -> why it has not confirmed."""

    def waits(self, name: str, machines: Collection[str], here: str) -> str:
        """Return why a service of this machine may not be started yet; "" if it may."""
        if name in self.owned:
            return ""
        for machine in others(self, name, machines, here):
            if machine not in self.confirmed.get(name, ()):
                why = self.kept.get(name, {}).get(machine, "has not answered")
                return f"{machine}, where it may still run, {why}"
        return "it is being taken over"


def others(owned: Owned, name: str, machines: Collection[str], here: str) -> list[str]:
    """Return the machines that must confirm before this one takes a service over."""
    return sorted({*machines, owned.last.get(name, here)} - {here})


def settled(
    owned: Owned,
    belongs: Mapping[str, str],
    here: str,
    present: Collection[str],
    numbers: Mapping[str, int],
    granted: Collection[str] = (),
) -> Owned:
    """Return what this machine owns after a pass.

    `belongs`: service -> machine, by the manifests; its machines are those in `numbers`, with the number of the last
    renewal sent to each. `present`: services of which something exists here, or may (a call is under way, or the engine
    has not answered). `granted`: services that a person has confirmed.
    """
    mine = {name for name, machine in belongs.items() if machine == here}
    # What runs here was started here. Without this a robot that is divided among machines would have to stop first.
    keeps = {n for n in owned.owned | set(present) if n in mine or n in present}
    taken = {
        name
        for name in mine - keeps
        if name in granted or set(others(owned, name, numbers, here)) <= owned.confirmed.get(name, frozenset())
    }
    keeps |= taken
    waiting = mine - keeps
    asked = {
        name: {m: owned.asked.get(name, {}).get(m, numbers[m] + 1) for m in numbers if m != here} for name in waiting
    }
    return Owned(
        frozenset(keeps),
        {
            **owned.last,
            **{n: m for n, m in belongs.items() if m != here and n not in keeps},
            **dict.fromkeys(keeps, here),
        },
        asked,
        {n: c for n, c in owned.confirmed.items() if n in waiting},
        {n: k for n, k in owned.kept.items() if n in waiting},
    )


def answered(owned: Owned, machine: str, number: int, answer: Answer) -> Owned:
    """Note what another machine's answer to renewal `number` says about services to take over. An answer to a question
    from before this machine's manifests gave it the service does not count."""
    asked = {n for n, since in owned.asked.items() if machine in since and number >= since[machine]}
    confirmed = {n: owned.confirmed.get(n, frozenset()) | {machine} for n in answer.released if n in asked}
    kept = {n: {**owned.kept.get(n, {}), machine: why} for n, why in answer.kept.items() if n in asked}
    if not confirmed and not kept:
        return owned
    return replace(owned, confirmed={**owned.confirmed, **confirmed}, kept={**owned.kept, **kept})


def replies(
    owned: Owned, belongs: Mapping[str, str], here: str, present: Collection[str], takes: Collection[str]
) -> tuple[tuple[str, ...], Mapping[str, str]]:
    """Return which of the services that another machine takes over are released, and why the others are not."""
    kept: dict[str, str] = {}
    for name in takes:
        if belongs.get(name) == here:
            kept[name] = "has manifests that give it to itself"
        elif name in owned.owned or name in present:
            kept[name] = "still has its container"
    return tuple(n for n in takes if n not in kept), kept
