"""The loop: one pass after another, level-triggered. A wake only says that a pass is worth it."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

from rorg.core.decide import Decision, decide
from rorg.core.dispatch import DispatchLimits, finish
from rorg.core.inputs import Inputs
from rorg.daemon.generations import Generations
from rorg.daemon.image_manager import ImageManager
from rorg.daemon.leases import Leases
from rorg.daemon.machines import Machines
from rorg.daemon.publisher import Publisher
from rorg.daemon.recorder import Recorder
from rorg.daemon.reporter import Reporter
from rorg.daemon.ros import Ros
from rorg.daemon.running import Running
from rorg.daemon.teardown import Teardown, is_down
from rorg.daemon.tree import Tree
from rorg.daemon.wakes import Wakes
from rorg.daemon.workers import Workers
from rorg.daemon.write_ahead import WriteAhead
from rorg.engines.observe import Observer
from rorg.engines.protocol import Engine
from rorg.host.clock import boot_id
from rorg.host.devices import DeviceWatch, elsewhere
from rorg.host.load import Sampler
from rorg.model.devices import Device, Plugged
from rorg.probes.prober import Prober
from rorg.store.requests_document import RequestsDocument
from rorg.store.state_dir import StateDir

SOON = 0.05
"""Seconds until a tree that was being written is read again."""
HANDOVER = 0.0003
"""Seconds that the pass sleeps so that a worker can make an urgent call, and callers who wait get their answer."""
GATHER = 0.005
"""Seconds for which outcomes and events are gathered before a pass, unless a request waits for one."""
PATIENCE = 3.5
"""Seconds that the end of the loop waits for calls and probes under way."""
AGAIN = 1.0
"""Seconds after a pass that a bug has ended."""


class Thread(Protocol):
    """Something that runs beside the loop."""

    def start(self) -> None: ...
    def stop(self) -> None: ...


@dataclass(eq=False, repr=False, kw_only=True)
class Loop:
    """Owns the state directory while it runs. `clock` gives monotonic seconds, `wall` seconds since the epoch."""

    state: StateDir
    tree: Tree
    engine: Engine
    observer: Observer
    prober: Prober
    sampler: Sampler
    running: Running
    ros: Ros
    workers: Workers
    leases: Leases
    recorder: Recorder
    publisher: Publisher
    devices: DeviceWatch
    machines: Machines
    images: ImageManager | None
    """None if the engine needs no images."""
    generations: Generations
    wakes: Wakes
    threads: tuple[Thread, ...]
    """They run as long as the loop does."""
    owner: str
    clock: Callable[[], float] = time.monotonic
    wall: Callable[[], float] = time.time
    boot: str = field(default_factory=boot_id)

    def __post_init__(self) -> None:
        self.questions: dict[object, Mapping[str, float]] = {}
        """Services that clients ask about or wait for, each with the time (`clock`) since when the answers of its probe
        count. If there is no such answer the probe is asked again."""
        memory = self.recorder.historian.remembered(self.clock(), self.boot)
        self.recorder.begin(memory)
        self.written = WriteAhead(self.state, self.engine, self.recorder)
        self.reporter = Reporter(self.recorder, self.engine, self.clock, memory)
        self.running.memory = replace(memory, kept=self.written.read())
        self.tree.masker.learn(self.running.memory.kept.catalog)
        self.dispatch = DispatchLimits()
        """Used if the Policy sets none."""
        self.passes = 0
        self.decision: Decision | None = None
        """The decision of the last pass."""
        self.inputs: Inputs | None = None
        """The inputs that it was made from."""
        self.decided: Callable[[], None] = lambda: None
        """Called after every pass, and as soon as it has decided, for those who wait for something."""
        self.teardown = Teardown()
        self._stopping = False

    def wake(self) -> None:
        self.wakes.wake()

    def stop(self) -> None:
        self._stopping = True
        self.wakes.wake()

    def run(self, until: Callable[[Decision], bool] | None = None) -> None:
        """Make passes until stop() is called, or until `until` accepts one. Without `until`, a bug in a pass is
        reported and the next pass follows: a robot without its loop would be worse off."""
        for thread in self.threads:
            thread.start()
        try:
            while not self._stopping:
                try:
                    decision = self.one_pass()
                    if self.is_down or (until and until(decision)):
                        return
                    self._sleep(decision)
                except Exception as bug:
                    if until:
                        raise
                    self._tell_bug(bug)
        finally:
            self._drain()

    def _tell_bug(self, bug: Exception) -> None:
        text = "".join(traceback.format_exception(bug)).strip()
        self.recorder.when_new("bug", text, "internal-error", f"internal error in a pass; trying again: {text}")
        self.wakes.clear()
        self.wakes.wait(AGAIN)

    def _sleep(self, decision: Decision) -> None:
        """Sleep until something woke the loop or is due. Publishing needs no pass."""
        until = [] if decision.deadline is None else [decision.deadline]
        until += [self.clock() + SOON] if self.wakes.files else []
        publish = self.publisher.due()
        if publish is not None and not self._wait(min([publish, *until])) and publish <= self.clock():
            self.publisher.flush()
        if not self.wakes.woken():
            self._wait(min(until, default=None))
        if not self._awaited(decision):
            self.wakes.gather(GATHER)
        self.wakes.clear()

    @staticmethod
    def _awaited(decision: Decision) -> bool:
        """Whether a live request waits for something."""
        situation = decision.situation
        return any(not decision.memory.of(n).ready for n in situation.urgent if n in situation.desired.digests)

    def _wait(self, until: float | None) -> bool:
        return self.wakes.wait(None if until is None else until - self.clock())

    def _drain(self) -> None:
        """Stop the threads; the observer last, because calls under way tell it their results."""
        for thread in reversed(self.threads):
            if thread is not self.observer:
                thread.stop()
        until = self.clock() + PATIENCE
        self.ros.ros2.exchange.close()
        self.workers.stop(PATIENCE)
        self.prober.join(until - self.clock())
        self.observer.stop()
        self.publisher.flush()
        self.recorder.history.close()

    @property
    def hung(self) -> int:
        """Number of calls and probes that have not ended: the interpreter would wait for their threads."""
        return len(self.workers.hung) + self.prober.hung

    # -- one pass ----------------------------------------------------------------------------------------------

    def one_pass(self) -> Decision:
        """Read, resolve, observe, plan, check, hand to workers, publish."""
        self.passes += 1
        upto = self.generations.begin()
        self._read_files(upto)
        self._take_outcomes()
        document, renewals = self.leases.document(), self.leases.renewals()
        self.observer.look_for(self.tree.desired.keys)
        asked = self._asked_for()
        inputs = self._inputs(document, renewals, asked)
        decision = decide(self.teardown.of(inputs) if document.down else inputs)
        self.leases.settle(decision, renewals)
        self.leases.follow_clock(inputs.moment)
        self.machines.decided(decision, asked)
        self.written.write(self.running.memory.kept, decision)
        self.publisher.note(decision)
        self.running.memory, self.decision, self.inputs = decision.memory, decision, inputs
        self.generations.acted = self.generations.read(upto, not self.wakes.files or self.tree.changes.restless)
        for action in decision.begin:
            self.workers.begin(action)
        if self.questions:
            self.decided()
        if self.questions or any(action.urgent for action in decision.begin):
            # The rest of this pass can wait. Those who share the interpreter with it would begin later.
            time.sleep(HANDOVER)
        self.prober.watch(decision.to_probe)
        self.observer.look(decision.to_look)
        self.ros.look(decision.situation)
        if not document.down:  # a robot that is down says nothing about its manifests
            self.recorder.historian.note(decision, decision.memory, self.tree, self.boot)
            if self.tree.overtaken:
                self.wakes.again()  # nothing is noted of it until it is read, and no event may follow
        self.tree.standing = self.recorder.historian.standing
        self.reporter.report(decision, self.tree, self.leases.file)
        self.publisher.publish(self.tree, self.leases.file)
        self.decided()
        return decision

    def _inputs(
        self, document: RequestsDocument, renewals: Mapping[tuple[str, str], int], asked: Mapping[str, float]
    ) -> Inputs:
        observed = self.ros.observed(self.observer.snapshot(), self.tree.desired.catalog)
        desired, peers = self.machines.known(self.tree.desired, self.tree.here, observed, self.running.memory.in_flight)
        return Inputs(
            desired=desired,
            peers=peers,
            requests=document.requests,
            restarts=document.restarts,
            observed=observed,
            results=self.prober.results(),
            memory=self.running.memory,
            now=self.clock(),
            owner=self.owner,
            engine=self.engine.capabilities,
            removals=self.tree.removals,
            limits=self.dispatch.allowing(
                self.tree.desired.catalog.policy.bulk_workers or self.engine.capabilities.bulk
            ),
            holds=document.holds,
            suspended=document.suspended,
            wall=self.wall(),
            boot=self.boot,
            load=self.sampler.latest,
            renewals=renewals,
            asked=asked,
            confirmed=document.removals,
            retries=document.retries,
            images=self.images.look(self.tree.desired, self.tree.images) if self.images else {},
            devices=self._devices(),
            ros=self.ros.graphs(self.tree.desired.catalog),
            unreported=self.ros.unreported(self.tree.desired.catalog),
            unsettled=self.tree.changes.unsettled,
            purge=document.down and document.purge,
            cache=self.decision.cache if self.decision else None,
        )

    def _devices(self) -> Mapping[Device, Plugged]:
        wanted = self.tree.desired.devices
        return self.devices.of(wanted) if self.engine.local else elsewhere(wanted)

    @property
    def is_down(self) -> bool:
        """Whether the robot has been taken down and nothing of it is left."""
        return is_down(self.leases.document(), self.decision)

    def _asked_for(self) -> dict[str, float]:
        """Service -> since when an answer of its probe counts for everyone who asks."""
        times: dict[str, float] = {}
        for asked in [*self.questions.values(), self.machines.questions()]:
            times.update({name: max(since, times.get(name, since)) for name, since in asked.items()})
        return times

    def _read_files(self, upto: int) -> None:
        check = self.wakes.take_check()
        if self.wakes.take_requests() or upto > self.generations.acted:
            self.leases.read()
            check = True  # what is read may be a request for what was just saved
        if check and self.tree.source is None and self.tree.changes.differ():
            self.wakes.again()
        if self.wakes.take_files():
            _, again = self.tree.read()
            if again:
                self.wakes.again()
            self.ros.parameters.write(self.tree.desired.catalog)

    def _take_outcomes(self) -> None:
        if outcomes := self.workers.take():
            self.running.memory = finish(self.running.memory, outcomes, self.clock())
            if self.images and any(o.missing for o in outcomes):
                self.images.check()
