"""Puts the parts of the loop together over the real clock: each gets what it needs, and none the loop itself."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path

from rorg.daemon.generations import Generations
from rorg.daemon.git_source import GitSource
from rorg.daemon.image_manager import ImageManager
from rorg.daemon.leases import Leases
from rorg.daemon.loop import Loop, Thread
from rorg.daemon.machines import Machines
from rorg.daemon.notifier import Notifier
from rorg.daemon.publisher import Publisher
from rorg.daemon.recorder import Recorder
from rorg.daemon.ros import make_ros
from rorg.daemon.running import Running
from rorg.daemon.tree import Tree
from rorg.daemon.usage_recorder import UsageRecorder
from rorg.daemon.wakes import Wakes
from rorg.daemon.workers import Workers
from rorg.engines.observe import Observer
from rorg.engines.protocol import Engine, Images
from rorg.history.maintenance import Maintenance
from rorg.history.retention import Retention
from rorg.history.usage import UsageTable
from rorg.host.clock import boot_id, wall_clock
from rorg.host.devices import DeviceWatch
from rorg.host.git_cache import Followed, GitCache
from rorg.host.load import Meter, Sampler, machine
from rorg.host.watch import Watcher
from rorg.images.records import NAME as RECORDS
from rorg.images.references import references_for
from rorg.images.supply import Supplier
from rorg.model.machines import MACHINE
from rorg.probes.prober import Prober
from rorg.probes.ros2_exchange import Ros2Exchange
from rorg.probes.runner import ProbeRunner
from rorg.store import machine_file
from rorg.store.last_good import read_last_catalog
from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir
from rorg.store.wakeup import Wakeup

JOBS = 2
"""Images that are built at the same time: the robot needs the CPU for other things."""


def make_loop(
    root: Path,
    state: StateDir,
    engine: Engine,
    say: Callable[[str], None],
    robot: str = "",
    source: GitSource | None = None,
    notifies: bool = True,
) -> Loop:
    """Return a loop over the real clock, ready to run. The caller holds the lock of the state directory. `say` gets a
    line for each event. `robot` and `source`: see make_tree()."""
    return loop_over(make_tree(root, state, engine.name, robot, source), state, engine, say, notifies)


def make_tree(root: Path, state: StateDir, engine: str, robot: str = "", source: GitSource | None = None) -> Tree:
    """Return this robot's tree for the engine of this name, not read yet. `robot`: whose overlay is used, by default
    the one named after this machine. `source`: follows a repository for it. Which of the robot's machines this is,
    the environment says; by default it is the one that it was last, or the one with its host name."""
    references, host = references_for(engine, state.path), os.uname().nodename
    machine = os.environ.get(MACHINE) or machine_file.read(state.path / machine_file.NAME).here
    return Tree(
        root.resolve(),
        str(state.run),
        engine=engine,
        references=references,
        named=robot,
        host=host,
        source=source,
        machine=machine,
        last=partial(read_last_catalog, state.path),
    )


def make_source(state: StateDir, followed: Followed, poll: float) -> GitSource:
    """Return what follows a repository, with its cache in the state directory; nothing is fetched yet."""
    return GitSource(GitCache(state.git.resolve(), followed, threading.Event()), poll, wall_clock)


def loop_over(tree: Tree, state: StateDir, engine: Engine, say: Callable[[str], None], notifies: bool = False) -> Loop:
    """The same over a tree that may have been read already. `notifies`: see _notifier()."""
    owner, clock, wakes = state.instance(), time.monotonic, tree.source.wakes if tree.source else Wakes()
    recorder = Recorder(state, say, wall_clock, tree.masker)
    about, stopping = {"pid": os.getpid(), "engine_name": engine.name, "instance": owner}, threading.Event()
    observer = Observer(engine, wakes.wake_soon, lambda: tree.desired.catalog.policy.resync, clock, wakes.wake)
    running = Running(tree, engine, observer, recorder)
    exchange, leases = Ros2Exchange(clock, wakes.wake), Leases(state.requests, recorder)
    asker = ProbeRunner(engine, running.container_of, stopping, recorder.parameters_set, exchange)
    prober = Prober(clock, wakes.wake, asker, stopping)
    sampler = Sampler(Meter(clock), running.sample_every, running.load_matters, running.use, wakes.wake)
    ros, devices = make_ros(state, recorder, exchange, wakes.wake, engine.local), DeviceWatch(wakes.wake)
    usage = _usage_recorder(recorder, running, engine)
    watcher = Watcher(lambda: [*tree.folders(), state.path], _changed(leases.file, wakes), _own_files(state))
    images = _image_manager(engine, owner, state, recorder, wakes)
    notifier, notified = _notifier(tree, recorder, wakes, notifies), Wakeup(state.path, wakes.requests_changed)
    bringers = (_maintenance(recorder, tree), *_bringers(tree.source, images))
    return Loop(
        state=state,
        tree=tree,
        engine=engine,
        observer=observer,
        prober=prober,
        sampler=sampler,
        running=running,
        ros=ros,
        workers=Workers(observer, recorder, wakes.wake_soon, running, usage.look, nodes=exchange),
        leases=leases,
        recorder=recorder,
        publisher=Publisher(state, clock, lambda: {**about, "notify": notifier.view()}, recorder.tell, tree.masker),
        images=images,
        devices=devices,
        machines=Machines(state.path, clock, wakes.wake, recorder.event, boot_id()),
        # By the time of day, so that numbers grow over a restart of rorg.
        generations=Generations(int(time.time() * 1000)),
        wakes=wakes,
        threads=(*bringers, prober, sampler, usage, ros.masters, devices, watcher, notified, notifier, observer),
        owner=owner,
    )


def _maintenance(recorder: Recorder, tree: Tree) -> Maintenance:
    return Maintenance(recorder.history, recorder.event, lambda: _retention(tree), time.time)


def _usage_recorder(recorder: Recorder, running: Running, engine: Engine) -> UsageRecorder:
    whole = machine if engine.local else None
    return UsageRecorder(UsageTable(recorder.history), running.alive, engine.usage, time.monotonic, wall_clock, whole)


def _notifier(tree: Tree, recorder: Recorder, wakes: Wakes, notifies: bool) -> Notifier:
    """It tells the targets of the Policy if the loop `notifies`; not for a command whose user sees what happens, and
    not for a robot that is only played."""
    host = os.uname().nodename
    targets = (lambda: tree.desired.catalog.policy.notify) if notifies else tuple
    return Notifier(targets, lambda: tree.robot or host, recorder, wakes.wake)


def _retention(tree: Tree) -> Retention:
    history = tree.desired.catalog.policy.history
    return Retention(days=history.days, events=history.events, revisions=history.revisions)


def _bringers(source: GitSource | None, images: ImageManager | None) -> list[Thread]:
    """What brings manifests and images: the follower of a repository, with a watch if that is on this machine."""
    threads: list[Thread] = [images] if images else []
    if source is None:
        return threads
    here = source.cache.followed.remote.local is not None
    return [*threads, source, *([Watcher(source.folders, lambda _: source.ask(), source.ignores)] if here else [])]


def _image_manager(
    engine: Engine, owner: str, state: StateDir, recorder: Recorder, wakes: Wakes
) -> ImageManager | None:
    if not isinstance(engine, Images):
        return None
    supplier = Supplier(engine, state, owner, JOBS, imports=False)
    return ImageManager(engine, supplier, recorder, wakes.wake)


def _changed(file: RequestsFile, wakes: Wakes) -> Callable[[Collection[str]], None]:
    """What file changes wake. After a request only its file has changed: the tree need not be looked at, and nothing if
    rorg itself has written it."""
    requests = {str(file.path)}

    def changed(paths: Collection[str]) -> None:
        if not paths or not requests.issuperset(paths):
            wakes.files_changed()
        elif not file.known:
            wakes.requests_changed()

    return changed


def _own_files(state: StateDir) -> Callable[[str], bool]:
    """Whether rorg itself writes a file: all of the state directory except requests and the record of builds."""
    others = (state.requests.name, RECORDS)
    return lambda path: path.startswith(str(state.path)) and path.rpartition("/")[2] not in others
