"""Containers that are only numbers: for speed, for faults, for evaluation. Time is an argument."""

from __future__ import annotations

import builtins
import contextlib
import itertools
import queue
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

from rorg.core.found_objects import FoundObject, FoundObjects
from rorg.core.objects import found_object
from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE, Container, from_labels
from rorg.engines.log_lines import LogLine, Reading
from rorg.engines.protocol import NONE, Engine, Usage
from rorg.errors import EngineError
from rorg.model.devices import Plugged
from rorg.model.engines import Capabilities
from rorg.model.joining import NAMESPACES
from rorg.model.objects import Kind, subject
from rorg.model.options import LIVE
from rorg.model.units import stamp

EPOCH = datetime(2026, 1, 1, tzinfo=UTC).timestamp()
LATENCY: Mapping[str, float] = {
    "create": 0.014,
    "start": 0.088,
    "pause": 0.013,
    "resume": 0.013,
    "stop": 0.047,
    "remove": 0.028,
    "rename": 0.005,
    "update": 0.010,
    "signal": 0.005,
}
"""Seconds each call takes: medians measured with Docker 20.10 on a 2-core machine."""


def iso(now: float) -> str:
    """Virtual seconds as a time of the engine's clock."""
    return stamp(EPOCH + now)


UNSUPPORTED = "not supported"
"""Fails as what an engine cannot do at all."""


@dataclass
class Faults:
    """What goes wrong. Keys are (verb, service)."""

    hang: dict[tuple[str, str], float] = field(default_factory=dict)
    """Extra seconds that a call takes."""
    fail: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    """Messages of the next failures, used up one by one."""
    spent: set[str] = field(default_factory=set)
    """Containers that cannot be started any more."""
    crash_after: dict[str, float] = field(default_factory=dict)
    """Service -> seconds after each start until it exits."""
    exit_code: int = 1
    bad: dict[str, str] = field(default_factory=dict)
    """Digest -> what is wrong with containers of it: `start` is refused, or they `exit` soon after it."""
    unreachable: bool = False


class SimEngine:
    """Calls happen at once when they are made; how long one would take is asked first, with latency()."""

    name = "sim"
    capabilities = Capabilities()
    local, address = False, ""
    """Nothing of this machine is a sim container's."""

    def __init__(self, owner: str, clock: Callable[[], float], faults: Faults | None = None) -> None:
        self.owner, self.clock, self.faults = owner, clock, faults or Faults()
        self.containers: dict[str, Container] = {}
        self.foreign: set[str] = set()
        """Names taken by containers that are not ours."""
        self.calls: list[tuple[float, str, str]] = []
        """Every call that changed something: (time, verb, service)."""
        self.needs: dict[str, tuple[float, int]] = {}
        """Service -> (cores, bytes) that it takes while it runs."""
        self.answers: dict[tuple[str, ...], tuple[int, bytes]] = {}
        """Command -> its exit code and output; all others say nothing and exit 0."""
        self.devices: dict[str, Plugged] = {}
        """Identity of a device -> what there is of it; nothing waits for others."""
        self.objects: dict[str, FoundObject] = {}
        """Networks and volumes by key, those of others too."""
        self._ids = (f"{n:064x}" for n in itertools.count(1))
        self._output: dict[str, bytes] = {}
        self._run_from: dict[str, int] = {}
        """Container -> where the output of its run of now begins."""
        self._joined: dict[str, list[str]] = {}
        """Container -> ids of those whose namespaces it has."""
        self._ran: dict[str, tuple[float, float | None]] = {}
        """Container -> seconds that its run of now has run, up to a pause; and since when it runs again."""
        self._followers: list[queue.SimpleQueue[str]] = []

    def latency(self, verb: str, service: str) -> float:
        return LATENCY[verb] + self.faults.hang.get((verb, service), 0.0)

    def ping(self) -> str:
        return "virtual time"

    def list(self, known: Mapping[str, Container] = NONE) -> builtins.list[Container]:
        return list(self.containers.values())

    def inspect(self, container: str) -> Container | None:
        return self.containers.get(container)

    def events(self, stop: threading.Event) -> Iterator[tuple[str, str]]:
        """Every change, in order. Who follows is in real time, whatever the clock says."""
        changes: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._followers.append(changes)
        try:
            yield "", ""
            while not stop.is_set():
                with contextlib.suppress(queue.Empty):
                    yield changes.get(timeout=0.05), ""
        finally:
            self._followers.remove(changes)

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:
        found = {}
        for container in containers:
            if container.alive and container.id in self._ran:
                cores, memory = self.needs.get(container.service, (0.0, 0))
                found[container.id] = Usage(cores * self._seconds(container.id), memory)
        return found

    def _seconds(self, container: str) -> float:
        before, since = self._ran[container]
        return before if since is None else before + self.clock() - since

    def create(
        self,
        name: str,
        spec: Mapping[str, Any],
        labels: Mapping[str, str],
        before: str = "",
        defaults: Collection[str] = (),
    ) -> str:
        self._fault("create", labels[LABEL_SERVICE])
        if name in self.foreign or any(c.name == name for c in self.containers.values()):
            raise EngineError(f"create {name}", f"the name {name} is already in use", kind="name_taken")
        container = next(self._ids)
        live = {k: v for k, v in spec.items() if k in LIVE and k != "container_name"}
        self._joined[container] = self._joins(name, spec)
        assert labels[LABEL_OWNER] == self.owner
        joins = {n: "" for n in spec.get("networks", {}) if subject("network", n) in self.objects}
        self.containers[container] = Container(
            container,
            name,
            state="created",
            live=live,
            created_at=iso(self.clock()),
            networks=joins,
            **from_labels(labels),
        )
        self._tell(container)
        return container

    def find_objects(self, keys: Collection[str]) -> FoundObjects:
        asked = frozenset(keys)
        found = {k: one for k, one in self.objects.items() if one.owner == self.owner or k in asked}
        return FoundObjects(found, asked, complete=True)

    def object_events(self, stop: threading.Event) -> Iterator[None]:
        """None beyond the first: whoever changes them here looks by itself."""
        yield
        stop.wait()

    def make_object(self, kind: Kind, name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> None:
        one = found_object(kind, name, next(self._ids), labels)
        self._fault("create", one.key)
        if one.key in self.objects:
            raise EngineError(f"create the {kind} {name}", "one of that name is there")
        self.objects[one.key] = one

    def remove_object(self, kind: Kind, name: str) -> None:
        one = self.objects.get(subject(kind, name))
        if one is None:
            return
        if one.owner != self.owner:
            raise EngineError(f"remove the {kind} {name}", "it is not rorg's", kind="foreign")
        self._fault("remove", one.key)
        users = [c.name for c in self.containers.values() if c.alive and name in c.networks]
        if users:
            raise EngineError(f"remove the {kind} {name}", f"connected to it: {', '.join(users)}", kind="in_use")
        del self.objects[one.key]

    def _joins(self, name: str, spec: Mapping[str, Any]) -> builtins.list[str]:
        """As Docker, which knows those that a container is joined to by their ids."""
        found = [v.removeprefix("container:") for o in NAMESPACES if (v := spec.get(o, "")).startswith("container:")]
        others = [v.partition(":")[0] for v in spec.get("volumes_from", ()) if not v.startswith("container:")]
        lost = [c for c in [*found, *others] if c not in self.containers]
        if lost:
            raise EngineError(f"create {name}", f"No such container: {lost[0]}")
        return found

    def start(self, container: str) -> None:
        self._join(container)
        for other in self._joined.get(container, ()):
            if other not in self.containers or not self.containers[other].alive:
                raise EngineError(f"start {container[:12]}", f"cannot join a container that does not run: {other}")
        if self.faults.bad.get(self._get(container).digest) == "start":
            raise EngineError(f"start {container[:12]}", "no such program")
        if container in self.faults.spent:
            raise EngineError(f"start {container[:12]}", f"task {container}: already exists", kind="spent")
        self._change(
            "start", container, ("created", "exited"), state="running", started_at=iso(self.clock()), exit_code=None
        )
        self._ran[container] = 0.0, self.clock()
        self._run_from[container] = len(self._output.get(container, b""))

    def _join(self, container: str) -> None:
        """A network that was joined once is joined again by its id, as with Docker."""
        found = self._get(container)
        for name, known in found.networks.items():
            there = self.objects.get(subject("network", name))
            if there is None or known not in ("", there.id):
                raise EngineError(f"start {found.service}", f"no network {known[:12] or name}", kind="conflict")
        ids = {name: self.objects[subject("network", name)].id for name in found.networks}
        self.containers[container] = replace(found, networks=ids)

    def pause(self, container: str) -> None:
        self._change("pause", container, ("running",), state="paused")
        self._ran[container] = self._seconds(container), None

    def resume(self, container: str) -> None:
        self._change("resume", container, ("paused",), state="running")
        self._ran[container] = self._seconds(container), self.clock()

    def stop(self, container: str, signal: str, grace: float) -> None:
        self._change("stop", container, ("running", "paused"), state="exited", exit_code=0)

    def signal(self, container: str, name: str) -> None:
        self._change("signal", container, ("running",))

    def remove(self, container: str, volumes: bool = False) -> None:
        self._change("remove", container, ("created", "exited", "dead"))
        del self.containers[container]
        self._output.pop(container, None)

    def rename(self, container: str, name: str) -> None:
        if name in self.foreign or any(c.name == name for c in self.containers.values() if c.id != container):
            raise EngineError(f"rename {container[:12]}", f"the name {name} is already in use", kind="name_taken")
        self._change("rename", container, (), name=name)

    def update(self, container: str, options: Mapping[str, Any]) -> None:
        self._change("update", container, (), live={**self._get(container).live, **options})

    def logs(self, container: str, follow: bool, tail: int | None) -> Iterator[bytes]:
        """What say() was told until now: following waits for nothing, since the time is virtual."""
        self._get(container)
        lines = self._output.get(container, b"").splitlines(keepends=True)
        yield from lines if tail is None else lines[max(0, len(lines) - tail) :]

    def log_lines(self, container: str, tail: int | None, since: float | None, whole: bool) -> Iterator[LogLine]:
        """Of no time, as say() gives none; all lines are whole."""
        place = 0
        for text in self.logs(container, False, tail):
            place += len(text)
            yield LogLine("", text, str(place))

    def log_follow(self, container: str, place: str, reading: Reading) -> Iterator[LogLine]:
        """What say() was told until now."""
        for line in self.log_lines(container, None, None, False):
            if int(line.place) > int(place or 0) and not reading.ended:
                yield line

    def log_since(self, container: str, place: str) -> Iterator[tuple[bytes, str]]:
        self._get(container)
        output = self._output.get(container, b"")
        yield output[int(place or self._run_from.get(container, 0)) :], str(output.rfind(b"\n") + 1)

    def exec(
        self, container: str, command: Sequence[str], timeout: float, stop: threading.Event | None = None
    ) -> tuple[int, bytes]:
        found = self._get(container)
        if found.state != "running":
            raise EngineError(f"run {command[0]} in {found.service}", f"it is {found.state}", kind="conflict")
        return self.answers.get(tuple(command), (0, b""))

    def close(self) -> None:
        pass

    # -- behind rorg's back ------------------------------------------------------------------------------------

    def plug(self, identity: str, node: str = "/dev/ttyUSB0", number: str = "c 188:0") -> None:
        """A device is plugged in, and has this node."""
        self.devices[identity] = Plugged(node, number)

    def unplug(self, identity: str) -> None:
        self.devices[identity] = Plugged(problem="is not there")

    def kill(self, container: str, code: int = 137) -> None:
        """It ends by itself."""
        self.containers[container] = replace(self._get(container), state="exited", exit_code=code)
        self._tell(container)

    def say(self, container: str, output: bytes) -> None:
        """Its program prints something."""
        self._output[self._get(container).id] = self._output.get(container, b"") + output

    def _tell(self, container: str) -> None:
        for changes in self._followers:
            changes.put(container)

    def _get(self, container: str) -> Container:
        if container not in self.containers:
            raise EngineError(f"find {container[:12]}", "no such container", kind="gone")
        return self.containers[container]

    def _fault(self, verb: str, service: str) -> None:
        messages = self.faults.fail.get((verb, service))
        if messages:
            why = messages.pop(0)
            raise EngineError(f"{verb} {service}", why, kind="unsupported" if why == UNSUPPORTED else "other")
        self.calls.append((self.clock(), verb, service))

    def _change(self, verb: str, container: str, states: tuple[str, ...], **fields: Any) -> None:
        found = self._get(container)
        if states and found.state not in states:
            raise EngineError(f"{verb} {found.service}", f"it is {found.state}", kind="conflict")
        self._fault(verb, found.service)
        self.containers[container] = replace(found, **fields)
        self._tell(container)


_held: type[Engine] = SimEngine
"""mypy holds it to the protocol here."""
