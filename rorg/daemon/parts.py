"""The parts that the loop uses; wiring.py makes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from rorg.daemon.generations import Generations
from rorg.daemon.image_manager import ImageManager
from rorg.daemon.leases import Leases
from rorg.daemon.publisher import Publisher
from rorg.daemon.recorder import Recorder
from rorg.daemon.ros_watch import RosWatch
from rorg.daemon.running import Running
from rorg.daemon.shared_memory import ShmPurger
from rorg.daemon.tree import Tree
from rorg.daemon.wakes import Wakes
from rorg.daemon.workers import Workers
from rorg.engines.observe import Observer
from rorg.engines.protocol import Engine
from rorg.host.devices import DeviceWatch
from rorg.host.load import Sampler
from rorg.probes.prober import Prober
from rorg.store.state_dir import StateDir


class Thread(Protocol):
    """Something that runs beside the loop."""

    def start(self) -> None: ...
    def stop(self) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Collaborators:
    """What feeds the loop, and what it acts through. `threads` run as long as it does."""

    state: StateDir
    tree: Tree
    engine: Engine
    observer: Observer
    prober: Prober
    sampler: Sampler
    running: Running
    ros: RosWatch
    shm: ShmPurger
    workers: Workers
    leases: Leases
    recorder: Recorder
    publisher: Publisher
    devices: DeviceWatch
    images: ImageManager | None
    """None if the engine needs no images."""
    generations: Generations
    wakes: Wakes
    threads: tuple[Thread, ...]
