"""How busy the machine is, and what each service uses of it: one sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Load:
    """One sample. `at` is the loop's clock, seconds."""

    at: float
    cpu: float
    """Cores in use since the previous sample."""
    cores: float
    memory: int
    """Bytes in use: those that are not available."""
    memory_total: int
    cpu_some: float = 0.0
    """PSI: percent of the last 10 s in which some program waited."""
    memory_some: float = 0.0
    use: Mapping[str, tuple[float, int]] = field(default_factory=dict)
    """Service -> (cores, bytes); empty while that is not measured: then nothing is concluded."""
