"""The loop: one pass after another, level-triggered. A wake says only that it is worth looking."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import nullcontext, suppress
from dataclasses import replace

from rorg.core.decide import Decision, Inputs, decide
from rorg.core.former import Kept
from rorg.core.lanes import Lanes
from rorg.core.memory import finish
from rorg.core.observed import Container
from rorg.core.plan import Action
from rorg.core.pressure import Load, pressed
from rorg.core.trial import refuse
from rorg.daemon.generations import Generations
from rorg.daemon.ledger import Ledger
from rorg.daemon.reporter import Reporter
from rorg.daemon.ros import RosPurger
from rorg.daemon.snapshot import recall
from rorg.daemon.tree import Tree
from rorg.engines.execute import perform, said_no
from rorg.engines.observe import Observer
from rorg.engines.probe import Asker
from rorg.engines.protocol import Engine
from rorg.errors import RorgError
from rorg.host.cgroups import reclaim
from rorg.host.load import Meter, Sampler
from rorg.host.probe import Prober
from rorg.host.watch import Watcher
from rorg.model.catalog import Thresholds
from rorg.model.units import format_memory
from rorg.store.bell import Bell
from rorg.store.last_good import read_kept, write_kept
from rorg.store.state_dir import StateDir, read_json

SOON = 0.05
"""Seconds until a tree that was being written is looked at again."""
AFTER = {"resume": "running", "pause": "paused"}
"""State after a verb that ends well and changes nothing else."""
LONGEST = 3600.0
"""Seconds of sleep at the most: a deadline may be centuries away."""
HANDOVER = 0.0003
"""Seconds that the pass steps aside, so that a worker can make the call that somebody waits for."""
AGAIN = 1.0
"""Seconds after a pass that a bug has ended."""
PATIENCE = 10.0
"""Seconds that the end of the loop waits for calls under way."""


class Loop:
    """Owns the state directory while it runs. `clock` gives monotonic seconds."""

    def __init__(self, tree: Tree, state: StateDir, engine: Engine, reporter: Reporter, owner: str,
                 clock: Callable[[], float], booted_at: str) -> None:
        self.tree, self.engine, self.reporter, self.owner = tree, engine, reporter, owner
        self.clock, self.booted_at = clock, booted_at
        self.ledger = Ledger(state.requests, reporter)
        self.observer = Observer(engine, self.wake, lambda: self.tree.desired.catalog.policy.resync)
        self.prober = Prober(clock, self.wake, Asker(engine, self._container))
        self.sampler = Sampler(Meter(clock), lambda: limits.step if (limits := self._limits()) else None,
                               self._load_matters, self.use, self.wake)
        self.ros = RosPurger(lambda node: self.reporter.event(
            "ros-purged", f"the stale registration of the ROS node {node} was taken out of the master", node=node))
        names = {state.requests.name}
        self.watcher = Watcher([tree.root, state.path], self.files_changed,
                               lambda path: path.startswith(str(state.path)) and path.rpartition("/")[2] not in names)
        self.bell = Bell(state.path, self._rung)
        self.workers = ThreadPoolExecutor(Lanes().most, thread_name_prefix="worker")
        self.generations = Generations(int(time.time() * 1000))
        self.questions: dict[object, tuple[tuple[str, ...], float]] = {}
        """Who waits for services: their names, and since when (`clock`). Their readiness is asked for anew."""
        self.state = state
        self.memory = replace(recall(read_json(state.status)), kept=read_kept(state.path))
        self.passes = 0
        self.decision: Decision | None = None
        """Of the last pass."""
        self.decided: Callable[[], None] = lambda: None
        """Called after every pass, for those who wait for something."""
        self._woken = threading.Event()
        self._files, self._asked = True, True
        """Whether the tree, or the requests file, may have changed."""
        self._outcomes: list[tuple[Action, str, bool]] = []
        self._calls: set[Future] = set()
        self.hung: set[Future] = set()
        """Calls that were still under way when the loop had ended."""
        self._lock = threading.Lock()
        self._stopping = False

    def wake(self) -> None:
        self._woken.set()

    def files_changed(self) -> None:
        self._files = self._asked = True
        self._woken.set()

    def _rung(self) -> None:
        self._asked = True
        self._woken.set()

    def stop(self) -> None:
        self._stopping = True
        self._woken.set()

    def run(self, until: Callable[[Decision], bool] | None = None) -> None:
        """Passes until stop() is called, or `until` says of a pass that this was all. Without it a bug in one pass is
        told, and does not end the next ones: a robot without its loop would be worse."""
        self.prober.start()
        self.sampler.start()
        self.ros.start()
        self.watcher.start()
        self.bell.start()
        self.observer.start()
        try:
            while not self._stopping:
                try:
                    decision = self.one_pass()
                    if until and until(decision):
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
        self.reporter.when_new("bug", text, "internal-error", f"internal error in a pass, tried again: {text}")
        self._woken.clear()
        self._wait(self.clock() + AGAIN)

    def _sleep(self, decision: Decision) -> None:
        """Until something woke the loop or is due. Publishing is no reason for another pass."""
        until = [] if decision.deadline is None else [decision.deadline]
        until += [self.clock() + SOON] if self._files else []
        publish = self.reporter.due()
        if publish is not None and not self._wait(min([publish, *until])) and publish <= self.clock():
            self.reporter.flush()
        if not self._woken.is_set():
            self._wait(min(until, default=None))
        self._woken.clear()

    def _wait(self, until: float | None) -> bool:
        return self._woken.wait(None if until is None else min(LONGEST, max(0.0, until - self.clock())))

    def _drain(self) -> None:
        """Stops the threads. Calls under way are waited for, but not for ever: what they do is observed next time."""
        self.bell.stop()
        self.watcher.stop()
        self.prober.stop()
        self.sampler.stop()
        self.ros.stop()
        _, self.hung = wait(tuple(self._calls), timeout=PATIENCE)
        self.workers.shutdown(wait=False, cancel_futures=True)
        self.observer.stop()
        self.reporter.flush()

    # -- one pass ----------------------------------------------------------------------------------------------

    def one_pass(self) -> Decision:
        """Read, resolve, observe, plan, check, hand to workers, publish."""
        self.passes += 1
        upto = self.generations.begin()
        self._read_files(upto)
        self._take_outcomes()
        asked, renewals = self.ledger.asked(), self.ledger.renewals()
        decision = decide(Inputs(
            desired=self.tree.desired, requests=asked.requests, restarts=asked.restarts,
            observed=self.observer.snapshot(), findings=self.prober.results(), memory=self.memory, now=self.clock(),
            owner=self.owner, removals=self.tree.removals, booted_at=self.booted_at,
            lanes=Lanes(bulk=self.tree.desired.catalog.policy.bulk_workers), holds=asked.holds,
            suspended=asked.suspended, wall=time.time(), load=self.sampler.latest, renewals=renewals,
            asked=self._asked_for(),
            confirmed=asked.removals,
        ))
        self.ledger.settle(decision, renewals)
        self._keep(decision.memory.kept)
        self.memory, self.decision = decision.memory, decision
        self.generations.acted = self.generations.read(upto, not self._files)
        for action in decision.begin:
            self._begin(action)
        if any(action.urgent for action in decision.begin):
            # What is left of this pass can wait; a worker that has to share the interpreter with it begins later.
            time.sleep(HANDOVER)
        self.prober.watch(decision.to_probe)
        self.ros.look(decision.situation)
        self.reporter.report(decision, self.tree, self.ledger.file)
        self.decided()
        return decision

    def _keep(self, kept: Kept) -> None:
        """Writes down what is declared, and what was, before anything is done on the word of another tree."""
        before = self.memory.kept
        if kept.catalog is not before.catalog or kept.former != before.former:
            try:
                write_kept(self.state.path, kept)
            except OSError as error:
                self.reporter.when_new("last-good", str(error), "last-good-not-written", str(error))

    def _begin(self, action: Action) -> None:
        """Hands an action to a worker. Whatever happens, an outcome comes of it."""
        try:
            call = self.workers.submit(self._work, action)
        except RuntimeError as error:  # no thread can be started now
            self._finished(action, str(error))
            return
        self._calls.add(call)
        call.add_done_callback(self._calls.discard)

    def _finished(self, action: Action, error: str, refused: bool = False) -> None:
        with self._lock:
            self._outcomes.append((action, error, refused))
        self.wake()

    def _asked_for(self) -> dict[str, float]:
        """Service -> when somebody last asked whether it is ready, and waits for the answer."""
        found: dict[str, float] = {}
        for names, since in sorted(list(self.questions.values()), key=lambda q: q[1]):
            found.update(dict.fromkeys(names, since))
        return found

    def _read_files(self, upto: int) -> None:
        if self._asked or upto > self.generations.acted:
            self._asked = False
            self.ledger.read()
        if self._files:
            self._files = False
            _, again = self.tree.read()
            if again:  # never the other way: a change may have come while it was read
                self._files = True

    def _take_outcomes(self) -> None:
        with self._lock:
            outcomes, self._outcomes = self._outcomes, []
        for action, error, refused in outcomes:
            self.memory = finish(self.memory, action, error, self.clock())
            self.memory = refuse(self.memory, action, error) if refused else self.memory

    # -- what the pass's helpers ask ---------------------------------------------------------------------------

    def _container(self, service: str) -> Container | None:
        return next(iter(self.observer.snapshot().by_service().get(service, [])), None)

    def _limits(self) -> Thresholds | None:
        return self.tree.desired.catalog.policy.pressure

    def _load_matters(self, load: Load) -> bool:
        limits = self._limits()
        return limits is not None and bool(self.memory.pressure.engaged or pressed(
            limits, self.tree.desired.catalog.policy.budget, load))

    def use(self) -> dict[str, tuple[float, int]]:
        """(CPU seconds since it began, bytes) of each service that is alive."""
        alive = [c for c in self.observer.snapshot().containers if c.alive]
        usage = self.engine.usage(alive)
        return {c.service: (usage[c.id].cpu, usage[c.id].memory) for c in alive if c.id in usage}

    # -- workers -----------------------------------------------------------------------------------------------

    def _work(self, action: Action) -> None:
        began, error, made, refused = self.clock(), "", "", False
        self._last_words(action)
        try:
            with self.observer.acting(action.container) if action.container else nullcontext():
                made = perform(self.engine, action)
        except RorgError as failed:
            error, refused = failed.why + (f"; try {failed.remedy}" if failed.remedy else ""), said_no(failed)
        except Exception as bug:  # a worker's bug must not lose the outcome, or the service stays in flight for ever
            error = f"internal error: {type(bug).__name__}: {bug}"
        try:
            if action.container and not error:
                self.observer.done(action.container, AFTER.get(action.verb, ""))
            elif made or action.container:
                self.observer.refresh(made or action.container)
            self.reporter.outcome(action, error, self.clock() - began)
        finally:
            self._finished(action, error, refused)
        if action.verb == "pause" and not error:
            self._reclaim(action)

    def _last_words(self, action: Action) -> None:
        """What a container said that did not come up, before it is gone."""
        if not action.args.get("words"):
            return
        with suppress(RorgError):
            said = b"".join(self.engine.logs(action.container, False, 10)).decode(errors="replace").strip()
            if said:
                self.reporter.event("last-words", f"the container of {action.service} that failed said last:\n{said}",
                                    service=action.service, container=action.container[:12])

    def _reclaim(self, action: Action) -> None:
        """Pushes out what a paused service has in memory, where its manifest asks for that and the machine has swap."""
        service = self.tree.desired.catalog.services.get(action.service)
        container = self._container(action.service)
        if not (service and service.idle.reclaim and container and container.state == "paused"
                and self.engine.capabilities.isolation):
            return
        try:
            freed = reclaim(container.pid)
        except OSError as error:
            self.reporter.event("reclaim-failed", f"memory of {service.name} stays: {error}", service=service.name)
        else:
            self.reporter.event("reclaimed", f"{format_memory(freed)} of {service.name} pushed out to swap",
                                service=service.name, bytes=freed)
