"""One attempt of a probe: asks the engine if the question needs it, otherwise this machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Protocol

from rorg.core.observed import Container
from rorg.core.ros_parameters import ROLE
from rorg.core.schedule import Target
from rorg.engines.protocol import Inspection
from rorg.errors import RorgError
from rorg.host.clock import run_age
from rorg.manifest.patterns import compiled
from rorg.model.engines import Capabilities
from rorg.model.probe import Probe
from rorg.model.ros import domain_of
from rorg.model.units import parse_time
from rorg.probes.answer import YES, Answer, cannot_ask, no
from rorg.probes.ask import ask_host, asks_this_machine, at
from rorg.probes.files import FileProbes
from rorg.probes.ros2_exchange import Ros2Exchange
from rorg.probes.ros_parameters import ensure

EXEC_TIMEOUT = 10.0
"""Seconds for a command inside the container."""
LOG_TIMEOUT = 5.0
"""Seconds for reading a log, once the engine has found the place; the next attempt continues there."""
NO_LOOP = "only a running rorg knows the ROS 2 graph"
ELSEWHERE = "the engine is on another machine"


class Asked(Inspection, Protocol):
    """The part of an engine that probes need."""

    capabilities: Capabilities
    local: bool

    def inspect(self, container: str) -> Container | None: ...


class ProbeRunner:
    """Makes attempts for the containers of one engine. Remembers how far each log was read."""

    def __init__(
        self,
        engine: Asked,
        container_of: Callable[[str], Container | None],
        stopping: threading.Event | None = None,
        told: Callable[[str, str, list[str]], None] = lambda *_: None,
        ros2: Ros2Exchange | None = None,
    ) -> None:
        """`stopping` ends the attempts under way. `told` is called with ROS parameters that were set: the service, the
        name of the graph, their names. `ros2` asks the ROS 2 graph."""
        self.engine, self.container_of, self.told, self.ros2 = engine, container_of, told, ros2
        self.stopping = stopping or threading.Event()
        self._files = FileProbes()
        self._read: dict[tuple[str, str, int], tuple[tuple[str, str], str | None]] = {}
        """(service, role, question) -> (incarnation, pattern), and the place in its log; None once a line matched."""

    def __call__(self, key: tuple[str, str], target: Target) -> Answer:
        service, role = key
        probe = target.probe
        if role == "interlock":
            return ask_host(probe)  # it is about this machine, wherever the engine is
        domain = domain_of(probe.graph)
        if role == ROLE:
            return (
                self._parameters(service, target) if domain is None else self._ros2_parameters(domain, service, target)
            )
        container = self.container_of(service) or target.container
        if container is None or container.incarnation != target.incarnation:
            return cannot_ask("this is a different run now")
        if domain is not None:
            return self._ros2(domain, probe, container)
        try:
            return self._ask((*key, target.part), probe, container)
        except RorgError as error:
            return cannot_ask(error.why)

    def _ask(self, key: tuple[str, str, int], probe: Probe, container: Container) -> Answer:
        match probe.kind:
            case "exec":
                return self._exec(probe, container)
            case "engine":
                return self._health(probe, container)
            case "log":
                return self._log(key, probe, container)
            case "file":
                return self._file(key, probe, container)
        if not self.engine.local and asks_this_machine(probe):
            if not container.address or probe.kind not in ("tcp", "http"):
                return cannot_ask(f"{ELSEWHERE}, and {probe} names no host")
            return ask_host(at(probe, container.address))
        return ask_host(probe)

    def _ros2(self, domain: int, probe: Probe, container: Container) -> Answer:
        """Ask the reporter of the graph. Endpoints from before this run began belong to an earlier run."""
        if self.ros2 is None:
            return cannot_ask(NO_LOOP)
        words = probe.target if isinstance(probe.target, tuple) else (str(probe.target),)
        noted = parse_time(container.started_at) if container.started_at else time.time()
        return self.ros2.ask(domain, probe.kind, words, run_age=run_age(container.pid, noted))

    def _ros2_parameters(self, domain: int, service: str, target: Target) -> Answer:
        """Set parameters at running nodes; those that start read them from their file."""
        if self.ros2 is None:
            return cannot_ask(NO_LOOP)
        answer = self.ros2.ask(domain, target.probe.kind, (), values=target.values)
        if answer.ok:
            self.told(service, target.probe.graph, sorted(target.values))
        return answer

    def _parameters(self, service: str, target: Target) -> Answer:
        master, digest = target.probe.graph, str(target.probe.target)
        if not self.engine.local and asks_this_machine(target.probe):
            return cannot_ask(f"{ELSEWHERE}, and {master} names no host")
        try:
            if ensure(master, service, digest, target.values, target.anew):
                self.told(service, master, sorted(target.values))
        except LookupError as error:
            return no(f"{master} refuses them: {error}")
        except OSError as error:
            return no(f"{master} does not answer: {error.strerror or error}")
        return YES

    def _exec(self, probe: Probe, container: Container) -> Answer:
        assert isinstance(probe.target, tuple)
        code, output = self.engine.exec(container.id, probe.target, EXEC_TIMEOUT, self.stopping)
        said = output.decode(errors="replace").strip().splitlines()
        return YES if code == 0 else no(f"{probe} exits {code}" + (f": {said[-1][:200]}" if said else ""))

    def _health(self, probe: Probe, container: Container) -> Answer:
        inspection = self.engine.inspect(container.id)
        if inspection is None:
            return cannot_ask("its container is gone")
        return (
            YES
            if inspection.health == probe.target
            else no(f"the engine says {inspection.health or 'nothing about its health'}")
        )

    def _file(self, key: tuple[str, str, int], probe: Probe, container: Container) -> Answer:
        isolated = self.engine.capabilities.isolation
        if not self.engine.local:
            return cannot_ask(ELSEWHERE)
        if isolated and not container.pid:
            return cannot_ask("the engine does not say which process it is")
        return self._files.ask(key, probe, container.pid, isolated, container.started_at)

    def _log(self, key: tuple[str, str, int], probe: Probe, container: Container) -> Answer:
        """One matching line is enough for a whole run."""
        about = container.incarnation, str(probe.target)
        known, place = self._read.get(key, (about, ""))
        place = place if known == about else ""
        until: float | None = None
        for text, after in () if place is None else self.engine.log_since(container.id, place):
            until = until or time.monotonic() + LOG_TIMEOUT
            place = None if compiled(about[1]).search(text.decode(errors="replace")) else after
            if place is None or time.monotonic() > until or self.stopping.is_set():
                break
        if key not in self._read:
            for other in [k for k in tuple(self._read) if self.container_of(k[0]) is None]:
                self._read.pop(other, None)  # its service is gone
        self._read[key] = about, place
        return YES if place is None else no(f"no line of its output matches {probe.target}")
