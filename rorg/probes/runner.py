"""One attempt of a probe: what needs the engine is asked of it, everything else of the machine."""

from __future__ import annotations

from collections.abc import Callable

from rorg.core.decide import Target
from rorg.core.observed import Container
from rorg.engines.protocol import Engine
from rorg.errors import RorgError
from rorg.manifest.patterns import compiled
from rorg.model.catalog import Probe
from rorg.probes.ask import CannotAsk, ask_host

EXEC_TIMEOUT = 10.0
"""Seconds for a command inside the container."""


class ProbeRunner:
    """Asks probes of one engine's containers. Remembers how far each log was read."""

    def __init__(self, engine: Engine, container_of: Callable[[str], Container | None]) -> None:
        self.engine, self.container_of = engine, container_of
        self._read: dict[str, tuple[str, str]] = {}
        """Service -> (incarnation, place in its log)."""

    def __call__(self, key: tuple[str, str], target: Target) -> str:
        service, role = key
        probe = target.probe
        if role == "interlock":
            return ask_host(probe)
        container = self.container_of(service) or target.container
        if container is None or container.incarnation != target.incarnation:
            raise CannotAsk("it is not the same run any more")
        try:
            return self._ask(service, role, probe, container)
        except RorgError as error:
            raise CannotAsk(error.why) from error

    def _ask(self, service: str, role: str, probe: Probe, container: Container) -> str:
        match probe.kind:
            case "exec":
                code, output = self.engine.exec(container.id, list(probe.target), EXEC_TIMEOUT)  # type: ignore[arg-type]
                said = output.decode(errors="replace").strip().splitlines()
                return "" if code == 0 else f"{probe} exits {code}" + (f": {said[-1][:200]}" if said else "")
            case "engine":
                found = self.engine.inspect(container.id)
                if found is None:
                    raise CannotAsk("its container is gone")
                health = found.health
                return "" if health == probe.target else f"the engine says {health or 'nothing of its health'}"
            case "log":
                return self._log(service, probe, container)
            case "file":
                return ask_host(probe, container.pid, role, self.engine.capabilities.isolation)
        return ask_host(probe)

    def _log(self, service: str, probe: Probe, container: Container) -> str:
        incarnation, place = self._read.get(service, ("", ""))
        text, place = self.engine.log_since(container.id, place if incarnation == container.incarnation else "")
        if compiled(str(probe.target)).search(text.decode(errors="replace")):
            self._read.pop(service, None)
            return ""
        self._read[service] = (container.incarnation, place)
        return f"no line of its output matches {probe.target}"
