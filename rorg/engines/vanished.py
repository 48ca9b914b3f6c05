"""Finds containers that the engine calls running although their processes have ended. An engine misses an end if the
process that watches the container is killed too, as Docker with live-restore does (docker/for-linux#761)."""

from __future__ import annotations

from collections.abc import Iterable

from rorg.core.observed import Container
from rorg.engines.process.table import stat
from rorg.host.cgroups import belongs

EVERY = 5.0
"""Seconds between two looks. An engine that works notices an end within one."""


class Vanished:
    """Used by one thread. Process ids mean something only if the engine's processes are in the PID namespace of rorg,
    which runs in a container on some robots. So there is no finding before one container was seen to have its
    process."""

    def __init__(self) -> None:
        self._seen: dict[str, tuple[int, int]] = {}
        """Container -> pid and start time of its process, in ticks."""
        self._ours = False
        """Whether the engine's pids are those of rorg."""
        self._missed: set[str] = set()
        """Runs without a process at the last look."""

    def look(self, containers: Iterable[Container]) -> set[str]:
        """Return the incarnations that had no process at this look and at the one before. Raises Unreachable."""
        running = [c for c in containers if c.state == "running" and c.pid]
        self._seen = {c.id: self._seen[c.id] for c in running if c.id in self._seen}
        missed = {c.incarnation for c in running if not self._has_process(c)} if running else set()
        before, self._missed = self._missed, missed if self._ours else set()
        return before & self._missed

    def _has_process(self, container: Container) -> bool:
        pid, facts = container.pid, stat(container.pid)
        if facts is None or facts[0] in "ZX":
            return False
        known, present = self._seen.get(container.id), (pid, facts[2])
        if known != present and belongs(pid, container.id):
            self._seen[container.id], self._ours = present, True
        # Another process may have the pid by now; without an earlier look, a cgroup of another name proves nothing.
        return self._seen.get(container.id, present) == present
