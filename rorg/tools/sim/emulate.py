"""Emulates a trace: plays it on a real engine, alternately with and without rorg. Stand-ins take the place of the
programs: each service of a tree runs a program that uses the CPU and memory that its manifest declares."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from rorg.daemon.tree import Tree
from rorg.errors import Invalid
from rorg.model.catalog import Catalog, Image, Service, Updating
from rorg.model.probe import Probe
from rorg.model.trace import Trace
from rorg.tools.sim.player import EmulatedRun, Player
from rorg.tools.sim.simulate import everything
from rorg.tools.sim.throwaway import ThrowawayRobot

PREFIX = "rorg-emulate-"
ALL_ON, RORG = "all-on", "rorg"
"""Names of the two runs of a pair, in order."""
PATIENCE = 300.0
"""Seconds until everything that runs at the beginning is ready."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """What to emulate."""

    root: Path
    """Directory of the manifests."""
    robot: str
    """The robot whose overlay applies; empty for none."""
    catalog: Catalog
    """The robot that the manifests declare."""
    images: Mapping[str, Image]
    """The image of the stand-ins, and its bases."""
    engine: str
    trace: Trace
    """The trace as it is played, after compression."""
    share: Share

    def stand_ins(self, prefix: str = PREFIX) -> Catalog:
        """The robot that runs. `prefix`: of its containers' names."""
        return stand_ins(self.catalog, self.images, self.share, prefix)


def emulate(experiment: Experiment, pairs: int, say: Callable[[str], None]) -> Generator[EmulatedRun, None, None]:
    """Plays the trace `pairs` times with everything on and with rorg, and yields each run when it is over. Closing the
    generator cleans up. `say` receives progress messages. Raises Invalid if the engine cannot be measured,
    Unreachable, and NotReady."""
    keeper = ThrowawayRobot(experiment.engine, PREFIX)
    try:
        if not keeper.engine.local:
            why = "it is on another machine, whose control groups cannot be read"
            raise Invalid("measure on this engine", why, "an engine of this machine")
        say(f"on the {experiment.engine} engine {keeper.engine.ping()}")
        keeper.build(experiment.stand_ins(), say)
        for number in range(1, pairs + 1):
            for name in (ALL_ON, RORG):
                say(f"pair {number} of {pairs}, {name}")
                yield _run(experiment, name, say)
    finally:
        keeper.clean_up(say)


def _quiet(_: str) -> None:
    """Discards a message."""


def _run(experiment: Experiment, name: str, say: Callable[[str], None]) -> EmulatedRun:
    robot = ThrowawayRobot(experiment.engine, PREFIX)
    try:
        return _played(experiment, robot, name, say)
    finally:
        robot.clean_up(say)


def _played(experiment: Experiment, robot: ThrowawayRobot, name: str, say: Callable[[str], None]) -> EmulatedRun:
    catalog = experiment.stand_ins(f"{robot.folder.name}-")
    tree = Tree(
        experiment.root.resolve(),
        str(robot.state.run),
        references=robot.references,
        named=experiment.robot,
        adapt=lambda _: catalog,  # edits of the manifests have no effect meanwhile
    )
    robot.build(catalog, _quiet)
    if name == ALL_ON:
        robot.requests.change(lambda asked: asked.put(everything(catalog, experiment.trace)))
    loop = robot.run(tree, _quiet, "rorg emulate")
    robot.wait("the start", lambda view: len(view["services"]) == len(catalog.services), PATIENCE)
    robot.settle("everything to be ready", PATIENCE)
    say(f"{len(robot.active())} services run; the trace takes {experiment.trace.duration:.0f} s")
    return Player(robot, loop, experiment.trace).play(name)


PROGRAM = "standin"
"""The program, and the image that contains it."""
MOST_CPU, MOST_MEMORY = 0.25, 0.25
"""Fractions of the machine that all stand-ins may take together by default, because other programs need it too."""
READY_AFTER = 0.1
"""Seconds until a stand-in counts as ready if its own program would have to answer the probe."""
TASK = 1.0
"""Seconds that a stand-in of a task runs."""
LOCAL = ("127.0.0.1", "localhost", "")


@dataclass(frozen=True, slots=True)
class Share:
    """Factors for declared cores and bytes, to scale them from another machine to this one."""

    cpu: float = 1.0
    memory: float = 1.0


def share_of(catalog: Catalog, names: Collection[str], cores: float, memory: float) -> Share:
    """The share with which these services together use at most MOST_CPU of the cores and MOST_MEMORY of the bytes."""
    cpu = sum(catalog.services[n].cpu for n in names)
    used = sum(catalog.services[n].memory for n in names)
    return Share(
        min(1.0, round(MOST_CPU * cores / cpu, 3)) if cpu else 1.0,
        min(1.0, round(MOST_MEMORY * memory / used, 3)) if used else 1.0,
    )


def stand_ins(catalog: Catalog, images: Mapping[str, Image], share: Share, prefix: str) -> Catalog:
    """The same robot with stand-ins. Its needs, conflicts, requests, idle policies, priorities and groups stay as they
    are.

    Containers get another image and names that start with `prefix`; they use no devices, files, networks or volumes of
    the robot. Delays and probes of a TCP port on this machine stay, and the stand-in answers them. All other probes
    become delays; of several probes, the first port counts. Nothing is connected in the ROS graph. Measures against
    pressure are off, because they depend on the machine, which is a different one here."""
    services = {name: _stand_in(one, share, prefix) if one.spec else one for name, one in catalog.services.items()}
    policy = replace(catalog.policy, pressure=None)
    return replace(catalog, services=services, images=images, networks={}, volumes={}, policy=policy)


def _stand_in(service: Service, share: Share, prefix: str) -> Service:
    ready, answers = _ready(service.ready)
    environment = {
        "RORG_SERVICE": service.name,
        "STANDIN_CPU": f"{service.cpu * share.cpu:.4f}",
        "STANDIN_MEMORY": f"{service.memory * share.memory:.0f}",
        **answers,
    }
    return Service(
        service.name,
        always_on=service.always_on,
        needs=service.needs,
        restarts_with=service.restarts_with,
        conflicts=service.conflicts,
        exclusive=service.exclusive,
        idle=replace(service.idle, reclaim=False, connected="pause"),
        update=Updating(),
        ready=ready,
        protected=service.protected,
        restart=service.restart,
        on_change="none",
        priority=service.priority,
        cpu=service.cpu * share.cpu,
        memory=round(service.memory * share.memory),
        spec={
            "container_name": f"{prefix}{service.name}",
            "image": PROGRAM,
            "entrypoint": [PROGRAM],
            "environment": environment,
            "init": True,
            "network_mode": "host",
            "stop_signal": "SIGTERM",
        },
        description=service.description,
        where=service.where,
    )


def _ready(probe: Probe | None) -> tuple[Probe | None, dict[str, str]]:
    """The probe of a stand-in, and the variables that make the stand-in answer it."""
    if probe is None or probe.kind == "delay":
        return probe, {}
    if probe.completed:
        return probe, {"STANDIN_EXIT_AFTER": f"{TASK:g}"}
    for one in probe.questions:
        host, _, port = str(one.target).rpartition(":")
        if one.kind == "tcp" and host in LOCAL and port.isdecimal():
            return replace(one, timeout=probe.timeout), {"STANDIN_READY": f"tcp:{port}"}
    return Probe("delay", READY_AFTER, timeout=probe.timeout), {}
