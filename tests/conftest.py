"""Engines for the tests: a private dockerd, the process engine, the sim engine; and the count of tests on each."""

from __future__ import annotations

import fcntl
import os
import random
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import hypothesis
import parallel
import pytest
import witnesses
from common import ROOT, SUPPORT, no_docker, run_in_container
from cpp_program import SANITIZERS, WARNINGS, compile_all

if TYPE_CHECKING:
    from dockerd import Dockerd
    from ros2_programs import Ros2

FAILED = os.environ.pop("RORG_TEST_FAILED", "")
"""Where .ci/twice looks for what failed. Tests that run pytest themselves do not write there."""
OURS = "RORG_TEST_", "RORG_PROOF_"
for _name in [name for name in os.environ if name.startswith("RORG_") and not name.startswith(OURS)]:
    del os.environ[_name]  # of whoever runs the tests: they are about robots of their own
# What is called python3 is this Python, not a script that looks for one and hears the signals that are meant for it.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).resolve().parent), os.environ.get("PATH", os.defpath)])
# Begun in the background of a shell, SIGINT is ignored, also by all that the tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
ENGINES = "docker", "process", "sim"
"""That tests have as parameters."""
_passed: Counter[str] = Counter()
_folders = parallel.Folders()

# `make test-all` meets new examples in each run. There is no deadline, because on a busy machine the time of an example
# means nothing.
hypothesis.settings.register_profile(
    "rorg", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow], print_blob=True
)
hypothesis.settings.load_profile("rorg")


def _seed(config: pytest.Config) -> str:
    """How to draw the same random examples again."""
    return f"RORG_TEST_SEED={config.getoption('hypothesis_seed')}"


def pytest_addoption(parser):
    parser.addoption("--folders", action="store_true", help="Show how long the tests of each folder took.")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    """Draws the seed of random examples unless somebody names one. All workers take the controller's."""
    if parallel.is_worker(config):
        config.option.hypothesis_seed = config.workerinput["rorg_seed"]
        # Ctrl-C reaches each process of a terminal, and then the controller sends SIGTERM.
        parallel.end_at_signals((signal.SIGTERM, signal.SIGINT))
        return
    if config.getoption("hypothesis_seed") is None:
        config.option.hypothesis_seed = os.environ.get("RORG_TEST_SEED") or str(random.SystemRandom().getrandbits(32))
    parallel.end_at_signals((signal.SIGTERM,))
    if config.getoption("numprocesses", None):
        workers = parallel.Workers(str(config.option.hypothesis_seed))
        config.pluginmanager.register(workers, parallel.Workers.__name__)


def pytest_unconfigure(config):
    """Lets a worker that has run its tests end in peace: xdist interrupts one that needs more than five seconds for
    that, as on a busy machine, which prints a warning."""
    if parallel.is_worker(config):
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@pytest.fixture(scope="session")
def dockerd() -> Iterator[Dockerd]:
    """A private daemon when one can be started, else an engine that answers, else a loud skip."""
    from dockerd import Dockerd, chosen, clean_up, import_base, reachable

    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    engine = chosen()
    if why := engine.missing():
        if engine is not Dockerd:
            no_docker(why)
        daemon = reachable()
        import_base(daemon.host)
        yield daemon
        return
    clean_up()
    daemon = engine(Path(subprocess.check_output(["mktemp", "-d", "/tmp/rorg-dockerd.XXXXXX"], text=True).strip()))
    try:
        try:
            daemon.start()
        except (RuntimeError, AssertionError) as error:
            no_docker(f"dockerd does not start: {error}")
        import_base(daemon.host)
        yield daemon
    finally:
        daemon.close()


@pytest.fixture(scope="session")
def ros_image(dockerd) -> str:
    """An image with real ROS 1 from Debian's packages, on the private daemon."""
    from debian_images import bring

    return bring(dockerd.host, ROOT / "images/ros1", "ros1-base")


@pytest.fixture(scope="session")
def dds_image(dockerd) -> str:
    """An image with a talker and a listener of ROS 2's wire, on the Fast DDS of Debian's packages."""
    from debian_images import bring

    return bring(dockerd.host, SUPPORT / "ros_nodes/dds", "dds-nodes")


@pytest.fixture(scope="session")
def rorg_image(dockerd, ros_image, tmp_path_factory) -> str:
    """The image of images/rorg/Dockerfile, on a Debian that is there already."""
    import docker

    context = tmp_path_factory.mktemp("context")
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, context)
    for name in ("rorg", "manifests", "images", "clients/python"):
        shutil.copytree(
            ROOT / name,
            context / name,
            symlinks=True,
            ignore=shutil.ignore_patterns("__pycache__", "build", "*.egg-info"),
        )
    arguments = {"BASE": ros_image}
    if os.environ.get("PIP_CERT"):
        shutil.copy(os.environ["PIP_CERT"], context / "authority.pem")
        arguments["PIP_CERT"] = "authority.pem"
    api = docker.APIClient(dockerd.host, version="auto", timeout=600)
    lines = list(
        api.build(
            path=str(context),
            dockerfile="images/rorg/Dockerfile",
            tag="rorg",
            buildargs=arguments,
            network_mode="host",
            decode=True,
            rm=True,
        )
    )
    assert api.images("rorg"), lines[-5:]
    return "rorg"


ROS_PACKAGE = ROOT / "clients/ros1/rorg_ros"
BUILD = """set -e
mkdir -p /ws/src; cp -r /package /ws/src/rorg_ros; cd /ws
catkin_make_isolated --install --install-space /out
g++ -O1 -I/out/include /nodes/caller.cpp -o /out/caller $(pkg-config --cflags --libs roscpp)"""


@pytest.fixture(scope="session")
def package(dockerd, ros_image, once):
    """The install space of the package, built by catkin; and a caller in C++."""

    def make(out: Path) -> None:
        binds = [f"{ROS_PACKAGE}:/package:ro", f"{out}:/out", f"{SUPPORT / 'ros_nodes'}:/nodes:ro"]
        run_in_container(dockerd.host, ros_image, BUILD, binds)

    return once("ros1-package", make)


BUILD_ROS2 = """set -e
mkdir /ws; cp -r /package /ws/src; cd /ws
python3 -c "import rorg_ros2_interfaces" && touch src/rorg_ros2_interfaces/COLCON_IGNORE
colcon build --merge-install --install-base /out"""


@pytest.fixture(scope="session")
def ros2(dockerd, once) -> Iterator[Ros2]:
    """Real ROS 2, with rorg's node built by colcon from a copy of clients/ros2. RORG_TEST_ROS2=/opt/ros/jazzy uses the
    one that is installed there."""
    from debian_images import bring_ros2, of_this_machine
    from ros2_programs import Ros2, domain_of_its_own

    own = os.environ.get("RORG_TEST_ROS2")
    image, mounts = of_this_machine(dockerd.host, Path(own)) if own else (bring_ros2(dockerd.host), ())

    def make(out: Path) -> None:
        binds = [*mounts, f"{ROOT / 'clients/ros2'}:/package:ro", f"{out}:/out"]
        run_in_container(dockerd.host, image, BUILD_ROS2, binds)

    out = once("ros2-package", make)
    with domain_of_its_own() as domain:
        yield Ros2(dockerd.host, image, out, domain, mounts, ("/entry",) if own else ())


@pytest.fixture(scope="session")
def once(tmp_path_factory) -> Callable[[str, Callable[[Path], None]], Path]:
    """What several need and nobody changes: `once(name, make)` is a folder that `make` has filled, in the first
    worker that asks; others wait for it."""
    root = Path(os.environ.get(parallel.SHARED) or tmp_path_factory.mktemp("shared"))

    def made(name: str, make: Callable[[Path], None]) -> Path:
        folder, complete = root / name, root / f"{name}.complete"
        with (root / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not complete.exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                make(folder)
                complete.touch()
        return folder

    return made


@pytest.fixture(scope="session")
def cpp_programs(once) -> Path:
    """The C++ client's programs, static, so that they run in any container."""

    def make(folder: Path) -> None:
        compile_all(
            [
                [ROOT / "clients/cpp/examples/tour.cpp", "-O1", "-static", *WARNINGS, "-o", folder / "tour"],
                [ROOT / "clients/cpp/tests/calls.cpp", "-static", *WARNINGS, "-o", folder / "calls"],
            ]
        )

    return once("cpp", make)


@pytest.fixture(scope="session")
def sanitized(tmp_path_factory) -> dict[str, Path]:
    """The program of the C++ client's tests, once for each sanitizer, with TLS."""
    folder = tmp_path_factory.mktemp("sanitized")
    made = {name: folder / name for name in SANITIZERS}
    calls = [ROOT / "clients/cpp/tests/calls.cpp", "-DRORG_WITH_TLS"]
    compile_all([[*calls, *SANITIZERS[n], "-o", path, "-lssl", "-lcrypto"] for n, path in made.items()])
    return made


@pytest.fixture(params=["sim", "process", pytest.param("docker", marks=pytest.mark.docker)])
def robot(request, tmp_path):
    """A robot on each engine in turn."""
    yield from _make_robot(request, tmp_path, request.param)


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.docker)])
def real_robot(request, tmp_path):
    """A robot with a real loop and real programs."""
    yield from _make_robot(request, tmp_path, request.param)


@pytest.fixture
def docker_robot(request, tmp_path):
    yield from _make_robot(request, tmp_path, "docker")


@pytest.fixture
def place(request, dockerd, tmp_path):
    """Where images are built: by the better builder, or the one that a test asks for."""
    from image_trees import Place

    from rorg.images import buildkit

    wanted = getattr(request, "param", "buildkit")
    if dockerd.podman and wanted == "classic":
        pytest.skip("Podman has one builder, which takes the place of both")
    if wanted == "buildkit" and not buildkit.find_command():
        no_docker("no docker command with BuildKit")
    found = Place(dockerd.host, wanted == "buildkit", tmp_path / "builds")
    yield found
    found.close()


@pytest.fixture
def process_engine(tmp_path):
    """Without a robot; what it runs is ended."""
    from rorg.engines.process.engine import ProcessEngine

    found = ProcessEngine("me", tmp_path / "process")
    yield found
    for container in found.list():
        found.stop(container.id, "SIGKILL", 5.0)
        found.remove(container.id)


@pytest.fixture
def slice_of_its_own(dockerd):
    """A control group: for tests that measure what they start, and nothing else of the machine."""
    from slices import Slice

    try:
        found = Slice()
    except OSError as error:
        no_docker(f"no control group can be made here: {error}")
    yield found
    found.close()


def _make_robot(request, tmp_path, kind):
    from robots import RealRobot, VirtualRobot

    host = request.getfixturevalue("dockerd").host if kind == "docker" else None
    found = VirtualRobot(tmp_path) if kind == "sim" else RealRobot(tmp_path, kind, host)
    yield found
    found.close()


def pytest_collection_modifyitems(items):
    """Whatever uses the engine is marked so: `make test` leaves these out."""
    for item in items:
        if "dockerd" in item.fixturenames or "docker_robot" in item.fixturenames:
            item.add_marker("docker")


def pytest_runtest_setup(item):
    from dockerd import chosen

    if (only := item.get_closest_marker("docker_only")) and chosen().podman:
        pytest.skip(f"not on Podman: {only.args[0]}")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    outcome = yield
    report = outcome.get_result()
    if report.failed:
        report.sections.append(("machine", f"load average {' '.join(map(str, os.getloadavg()))} on {os.cpu_count()}"))
        report.sections += witnesses.told()
        if hypothesis.is_hypothesis_test(getattr(item, "obj", None)):
            report.sections.append(("random examples", f"the same again: {_seed(item.config)} pytest '{item.nodeid}'"))
    if call.when == "teardown":
        witnesses.forget_closed()
    if call.when == "call" and report.passed:
        report.user_properties.append(("engine", _engine(item)))  # which reaches the controller


def _engine(item: pytest.Item) -> str:
    """The engine that a test ran on, which may be the value of a parameter of any name, or "no engine"."""
    params = item.callspec.params.values() if hasattr(item, "callspec") else ()
    needs_docker = item.get_closest_marker("docker") is not None
    for engine in ENGINES:
        if engine in params and (needs_docker or engine != "docker"):
            return engine
    return "docker" if needs_docker else "no engine"


def pytest_runtest_logreport(report):
    _folders.count(report)
    if report.when == "call" and report.passed:
        _passed[dict(report.user_properties).get("engine", "")] += 1


def pytest_terminal_summary(terminalreporter, exitstatus):
    config = terminalreporter.config
    if parallel.is_worker(config):
        return  # the controller has the reports of all
    if not parallel.all_ran(config):
        terminalreporter.write_line("A WORKER ENDED EARLY: not all tests ran", red=True, bold=True)
    elif FAILED and exitstatus == pytest.ExitCode.TESTS_FAILED:
        reports = [r for kind in ("failed", "error") for r in terminalreporter.stats.get(kind, ())]
        parallel.write_failed(Path(FAILED), reports)
    if config.getoption("folders"):
        terminalreporter.section("time by folder")
        for line in _folders.lines():
            terminalreporter.write_line(line)
    counts = ", ".join(f"{_passed[k]} on {k}" for k in ENGINES if _passed[k])
    terminalreporter.write_line(f"random examples: {_seed(config)}")
    terminalreporter.write_line(f"tests passed by engine: {counts or 'none'}; {_passed['no engine']} need no engine")
    if not _passed["docker"] and config.option.markexpr != "not docker":
        terminalreporter.write_line("NO TEST RAN ON DOCKER", red=True, bold=True)
