"""The sim engine: containers that are only numbers, for fast tests, faults and evaluation. Time is an argument."""

from __future__ import annotations

import builtins
import contextlib
import itertools
import queue
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from rorg.core.objects import found_object
from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE, Container, FoundObject, FoundObjects, from_labels
from rorg.engines.log_lines import LogLine, Reading
from rorg.engines.protocol import NONE, Engine, Usage
from rorg.errors import EngineError
from rorg.model.devices import Plugged
from rorg.model.engines import Capabilities
from rorg.model.joining import NAMESPACES
from rorg.model.objects import Kind, subject
from rorg.model.options import LIVE
from rorg.model.units import stamp
from rorg.tools.sim.calls import LATENCY, UNSUPPORTED, Faults

Clock = Callable[[], float]
EPOCH = datetime(2026, 1, 1, tzinfo=UTC).timestamp()


def iso(now: float) -> str:
    """A virtual time, in seconds, as the engine writes it."""
    return stamp(EPOCH + now)


class SimEngine:
    """Every call takes effect immediately. latency() says how long it would have taken."""

    name = "sim"
    capabilities = Capabilities()
    local, address = False, ""
    """Containers of this engine use nothing of this machine."""

    def __init__(self, owner: str, clock: Clock, faults: Faults | None = None, wall: Clock | None = None) -> None:
        """`clock` is virtual time, in seconds; `wall` the machine's clock, which may be set."""
        self.owner, self.clock, self.faults, self.wall = owner, clock, faults or Faults(), wall or clock
        self.containers: dict[str, Container] = {}
        self.foreign: set[str] = set()
        """Names taken by containers that do not belong to rorg."""
        self.calls: list[tuple[float, str, str]] = []
        """Every call that changed something: (time, verb, service)."""
        self.needs: dict[str, tuple[float, int]] = {}
        """Service -> (cores, bytes) that it uses while it runs."""
        self.answers: dict[tuple[str, ...], tuple[int, bytes]] = {}
        """Command -> its exit code and output; other commands print nothing and exit with 0."""
        self.devices: dict[str, Plugged] = {}
        """Identity of a device -> its state. Services do not wait for any other device."""
        self.objects: dict[str, FoundObject] = {}
        """Networks and volumes by key, including those that do not belong to rorg."""
        self._ids = (f"{n:012x}".ljust(64, "0") for n in itertools.count(1))
        self.starts = 0
        """Runs begun so far."""
        self._output: dict[str, bytes] = {}
        self._run_from: dict[str, int] = {}
        """Container -> where the output of its current run begins."""
        self._joined: dict[str, list[str]] = {}
        """Container -> ids of the containers whose namespaces or volumes it joins."""
        self._ran: dict[str, tuple[float, float | None]] = {}
        """Container -> seconds that its current run had run before the last pause; and since when it runs again."""
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
        """Every change, in order, delivered in real time."""
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
        running = {c.id: self.needs.get(c.service, (0.0, 0)) for c in containers if c.alive and c.id in self._ran}
        return {one: Usage(cores * self._seconds(one), memory) for one, (cores, memory) in running.items()}

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
        self._check_name(f"create {name}", name)
        container = next(self._ids)
        live = {k: v for k, v in spec.items() if k in LIVE and k != "container_name"}
        self._joined[container] = self._joins(name, spec)
        assert labels[LABEL_OWNER] == self.owner
        joins = {n: "" for n in spec.get("networks", {}) if subject("network", n) in self.objects}
        made = Container(container, name, state="created", live=live, networks=joins, **from_labels(labels))
        self.containers[container] = replace(made, created_at=iso(self.wall()))
        self._tell(container)
        return container

    def find_objects(self, keys: Collection[str]) -> FoundObjects:
        asked = frozenset(keys)
        objects = {k: one for k, one in self.objects.items() if one.owner == self.owner or k in asked}
        return FoundObjects(objects, asked, complete=True)

    def object_events(self, stop: threading.Event) -> Iterator[None]:
        """Only the first event: after changing objects, callers look again without one."""
        yield
        stop.wait()

    def make_object(self, kind: Kind, name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> None:
        one = found_object(kind, name, next(self._ids), labels)
        self._fault("create", one.key)
        if one.key in self.objects:
            raise EngineError(f"create the {kind} {name}", "the name is already in use")
        self.objects[one.key] = one

    def remove_object(self, kind: Kind, name: str) -> None:
        one = self.objects.get(subject(kind, name))
        if one is None:
            return
        if one.owner != self.owner:
            raise EngineError(f"remove the {kind} {name}", "it does not belong to rorg", kind="foreign")
        self._fault("remove", one.key)
        users = [c.name for c in self.containers.values() if c.alive and name in c.networks]
        if users:
            raise EngineError(f"remove the {kind} {name}", f"connected to it: {', '.join(users)}", kind="in_use")
        del self.objects[one.key]

    def _joins(self, name: str, spec: Mapping[str, Any]) -> builtins.list[str]:
        """Ids of joined containers. Like Docker, the engine finds them by id, not by name."""
        ids = [v.removeprefix("container:") for o in NAMESPACES if (v := spec.get(o, "")).startswith("container:")]
        others = [v.partition(":")[0] for v in spec.get("volumes_from", ()) if not v.startswith("container:")]
        lost = [c for c in [*ids, *others] if c not in self.containers]
        if lost:
            raise EngineError(f"create {name}", f"No such container: {lost[0]}")
        return ids

    def start(self, container: str) -> None:
        self._join(container)
        what = f"start {container[:12]}"
        for other in self._joined.get(container, ()):
            if other not in self.containers or not self.containers[other].alive:
                raise EngineError(what, f"cannot join a container that does not run: {other}")
        if self.faults.bad.get(self._get(container).digest) == "start":
            raise EngineError(what, "no such program")
        if container in self.faults.spent:
            raise EngineError(what, f"task {container}: already exists", kind="spent")
        run = {"started_at": iso(self.wall()), "start_number": self.starts + 1}
        self._change("start", container, ("created", "exited"), state="running", exit_code=None, **run)
        self.starts += 1
        self._ran[container] = 0.0, self.clock()
        self._run_from[container] = len(self._output.get(container, b""))

    def _join(self, container: str) -> None:
        """Joins a network for the second time by its id, like Docker."""
        target = self._get(container)
        for name, known in target.networks.items():
            there = self.objects.get(subject("network", name))
            if there is None or known not in ("", there.id):
                raise EngineError(f"start {target.service}", f"no network {known[:12] or name}", kind="conflict")
        ids = {name: self.objects[subject("network", name)].id for name in target.networks}
        self.containers[container] = replace(target, networks=ids)

    def pause(self, container: str) -> None:
        self._turn("pause", container, ("running", "inactive"), "paused")

    def resume(self, container: str) -> None:
        self._turn("resume", container, ("paused",), "running")

    def activate(self, container: str, domain: int, nodes: Sequence[str]) -> None:
        self._turn("activate", container, ("inactive",), "running")

    def deactivate(self, container: str, domain: int, nodes: Sequence[str]) -> None:
        self._turn("deactivate", container, ("running",), "inactive")

    def _turn(self, verb: str, container: str, before: tuple[str, ...], state: str) -> None:
        self._change(verb, container, before, state=state)
        self._ran[container] = self._seconds(container), self.clock() if state == "running" else None

    def stop(self, container: str, signal: str, grace: float) -> None:
        self._change("stop", container, ("running", "inactive", "paused"), state="exited", exit_code=0)

    def signal(self, container: str, name: str) -> None:
        self._change("signal", container, ("running",))

    def remove(self, container: str, volumes: bool = False) -> None:
        self.faults.keep(self.containers, container)
        self._change("remove", container, ("created", "exited", "dead"))
        del self.containers[container]

    def rename(self, container: str, name: str) -> None:
        self._check_name(f"rename {container[:12]}", name, container)
        self._change("rename", container, (), name=name)

    def update(self, container: str, options: Mapping[str, Any]) -> None:
        self._change("update", container, (), live={**self._get(container).live, **options})

    def log_lines(self, container: str, tail: int | None, since: float | None, whole: bool) -> Iterator[LogLine]:
        """Output from say() so far, without a time, because say() has none."""
        self._get(container)
        lines, place = self._output.get(container, b"").splitlines(keepends=True), 0
        for text in lines if tail is None else lines[max(0, len(lines) - tail) :]:
            place += len(text)
            yield LogLine("", text, str(place))

    def log_follow(self, container: str, place: str, reading: Reading) -> Iterator[LogLine]:
        """Output from say() so far."""
        lines = self.log_lines(container, None, None, False)
        yield from (line for line in lines if int(line.place) > int(place or 0) and not reading.is_set())

    def log_since(self, container: str, place: str) -> Iterator[tuple[bytes, str]]:
        self._get(container)
        output = self._output.get(container, b"")
        yield output[int(place or self._run_from.get(container, 0)) :], str(output.rfind(b"\n") + 1)

    def exec(
        self, container: str, command: Sequence[str], timeout: float, stop: threading.Event | None = None
    ) -> tuple[int, bytes]:
        if (target := self._get(container)).state != "running":
            raise EngineError(f"run {command[0]} in {target.service}", f"it is {target.state}", kind="conflict")
        return self.answers.get(tuple(command), (0, b""))

    def close(self) -> None:
        pass

    # -- events that rorg does not cause -----------------------------------------------------------------------

    def plug(self, identity: str, node: str = "/dev/ttyUSB0", number: str = "c 188:0") -> None:
        """Plugs in a device with this node."""
        self.devices[identity] = Plugged(node, number)

    def unplug(self, identity: str) -> None:
        self.devices[identity] = Plugged(problem="is not there")

    def kill(self, container: str, code: int = 137) -> None:
        """The container exits."""
        self.containers[container] = replace(self._get(container), state="exited", exit_code=code)
        self._tell(container)

    def say(self, container: str, output: bytes) -> None:
        """The program prints something."""
        self._output[self._get(container).id] = self._output.get(container, b"") + output

    def _tell(self, container: str) -> None:
        for changes in self._followers:
            changes.put(container)

    def _check_name(self, what: str, name: str, own: str = "") -> None:
        if name in self.foreign or [c for c in self.containers.values() if c.name == name and c.id != own]:
            raise EngineError(what, f"the name {name} is already in use", kind="name_taken")

    def _get(self, container: str) -> Container:
        if container not in self.containers:
            raise EngineError(f"find {container[:12]}", "no such container", kind="gone")
        return self.containers[container]

    def _fault(self, verb: str, service: str) -> None:
        if messages := self.faults.fail.get((verb, service)):
            why = messages.pop(0)
            raise EngineError(f"{verb} {service}", why, kind="unsupported" if why == UNSUPPORTED else "other")
        self.calls.append((self.clock(), verb, service))

    def _change(self, verb: str, container: str, states: tuple[str, ...], **fields: Any) -> None:
        target = self._get(container)
        if states and target.state not in states:
            raise EngineError(f"{verb} {target.service}", f"it is {target.state}", kind="conflict")
        self._fault(verb, target.service)
        self.containers[container] = replace(target, **fields)
        self._tell(container)


_checked: type[Engine] = SimEngine
"""Makes mypy check the class against the protocol."""
