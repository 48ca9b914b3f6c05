"""Engines for the tests: a private dockerd, the process engine, the sim engine; and the count of tests on each."""

from __future__ import annotations

import hashlib
import os
import shutil
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

ROOT = Path(__file__).parent.parent
for _name in ("RORG_STATE_DIR", "RORG_ENGINE", "RORG_SOCKET", "RORG_ADDRESS", "RORG_RUN_DIR"):
    os.environ.pop(_name, None)  # of whoever runs the tests: they are about robots of their own
BASE_IMAGE = "rorg-base"
_ran: Counter[str] = Counter()


def wait_for(condition, seconds: float = 20.0, what: str = "the condition"):
    """Polls a condition with a deadline; returns its first true value."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        value = condition()
        if value:
            return value
        time.sleep(0.005)
    raise AssertionError(f"not within {seconds} s: {what}")


def free_port() -> int:
    """A TCP port that nobody uses now."""
    with socket.create_server(("127.0.0.1", 0)) as found:
        return found.getsockname()[1]


def no_docker(reason: str):
    """A test that cannot run for want of an engine: a failure where the engine should have been brought."""
    if os.environ.get("RORG_TEST_REQUIRE_DOCKER"):
        pytest.fail(f"a Docker engine is required here: {reason}")
    pytest.skip(f"NO DOCKER ENGINE: {reason}")


class Dockerd:
    """A private daemon that can be killed and started again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.host = f"unix://{folder}/docker.sock"
        self.process: subprocess.Popen | None = None

    def start(self) -> None:
        log = (self.folder / "dockerd.log").open("ab")
        # A runtime whose containers do not start while the file `hold` is there.
        hang = self.folder / "hang"
        wait = f"while [ -e {self.folder}/hold ]; do sleep 0.05; done"
        hang.write_text(f'#!/bin/sh\ncase " $* " in *" start "*) {wait};; esac\nexec runc "$@"\n')
        hang.chmod(0o755)
        self.process = subprocess.Popen(
            [
                "dockerd",
                "--data-root",
                f"{self.folder}/data",
                "--exec-root",
                f"{self.folder}/exec",
                "--pidfile",
                f"{self.folder}/pid",
                "--host",
                self.host,
                "--bridge=none",
                "--iptables=false",
                "--exec-opt",
                "native.cgroupdriver=cgroupfs",
                "--add-runtime",
                f"hang={hang}",
            ],
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        wait_for(self.answers, 60, f"dockerd, see {self.folder}/dockerd.log")

    def answers(self) -> bool:
        if self.process is not None and self.process.poll() is not None:
            raise RuntimeError((self.folder / "dockerd.log").read_text()[-2000:])
        import docker

        try:
            return docker.APIClient(self.host, version="auto").ping()
        except docker.errors.DockerException:
            return False

    def stop(self, kill: bool = False) -> None:
        if self.process:
            (self.process.kill if kill else self.process.terminate)()
            self.process.wait(30)
            self.process = None
            pid = self.folder / "exec/containerd/containerd.pid"
            if pid.exists():
                # A killed daemon takes its containerd along, but not at once; the next one would wait for the dying.
                wait_for(lambda: not os.path.exists(f"/proc/{pid.read_text().strip()}"), 30, "containerd to end")
                pid.unlink()


class Reachable(Dockerd):
    """An engine that somebody else runs: used as it is, never stopped."""

    def __init__(self, host: str) -> None:
        self.host = host


@pytest.fixture(scope="session")
def dockerd(tmp_path_factory) -> Iterator[Dockerd]:
    """A private daemon when one can be started, else an engine that answers, else a loud skip."""
    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    if os.geteuid() == 0 and shutil.which("dockerd"):
        folder = Path(subprocess.check_output(["mktemp", "-d", "/tmp/rorg-dockerd.XXXXXX"], text=True).strip())
        daemon = Dockerd(folder)
        try:
            daemon.start()
        except (RuntimeError, AssertionError) as error:
            shutil.rmtree(folder, ignore_errors=True)
            no_docker(f"dockerd does not start: {error}")
        _import_base(daemon.host)
        yield daemon
        daemon.stop()
        mounts = [line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]
        for mount in sorted((m for m in mounts if m.startswith(f"{folder}/")), reverse=True):
            subprocess.run(["umount", "-l", mount], check=False)
        shutil.rmtree(folder, ignore_errors=True)
        return
    import docker

    try:
        api = docker.from_env(version="auto").api
        api.ping()
    except docker.errors.DockerException as error:
        no_docker(f"no dockerd to start as root, and none answers ({error})")
    daemon = Reachable(api.base_url.replace("http+docker://localhost", "unix:///var/run/docker.sock"))
    _import_base(daemon.host)
    yield daemon


def _import_base(host: str) -> None:
    import docker

    api = docker.APIClient(host, version="auto")
    if not api.images(BASE_IMAGE):
        made = subprocess.Popen([sys.executable, str(ROOT / "images/base/rootfs.py")], stdout=subprocess.PIPE)
        api.import_image(src=made.stdout, repository=BASE_IMAGE, stream_src=True)
        assert made.wait() == 0


@pytest.fixture(scope="session")
def ros_image(dockerd) -> str:
    """An image with real ROS 1 from Debian's packages, on the private daemon. Built once a machine, then kept as a
    file, since each session has an empty daemon."""
    import docker

    folder, name = ROOT / "images/ros1", "ros1-base"
    api = docker.APIClient(dockerd.host, version="auto", timeout=600)
    if api.images(name):
        return name
    key = hashlib.sha256(b"".join(p.read_bytes() for p in sorted(folder.iterdir()) if p.is_file())).hexdigest()[:16]
    kept = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / f"rorg-tests/{name}-{key}.tar"
    if kept.exists():
        with kept.open("rb") as file:
            api.load_image(file)
        return name
    if not shutil.which("debootstrap"):
        no_docker("debootstrap is not installed, so no image with ROS can be made")
    made = subprocess.Popen([str(folder / "rootfs.sh")], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    api.import_image(src=made.stdout, repository="debian", tag="bookworm-slim", stream_src=True)
    assert made.wait() == 0
    lines = list(api.build(path=str(folder), tag=name, network_mode="host", decode=True, rm=True))
    assert api.images(name), lines[-5:]
    kept.parent.mkdir(parents=True, exist_ok=True)
    with kept.with_suffix(".new").open("wb") as file:
        for chunk in api.get_image(name):
            file.write(chunk)
    kept.with_suffix(".new").rename(kept)
    return name


ROS_PACKAGE = ROOT / "clients/ros1/rorg_ros"
BUILD = """set -e
mkdir -p /ws/src; cp -r /package /ws/src/rorg_ros; cd /ws
catkin_make_isolated --install --install-space /out
g++ -O1 -I/out/include /nodes/caller.cpp -o /out/caller $(pkg-config --cflags --libs roscpp)"""


@pytest.fixture(scope="session")
def package(dockerd, ros_image, tmp_path_factory):
    """The install space of the package, built by catkin; and a caller in C++."""
    import docker

    out = tmp_path_factory.mktemp("package") / "out"
    out.mkdir()
    api = docker.APIClient(dockerd.host, version="auto")
    made = api.create_container(
        ros_image,
        ["bash", "-c", BUILD],
        host_config=api.create_host_config(
            network_mode="host",
            binds=[f"{ROS_PACKAGE}:/package:ro", f"{out}:/out", f"{ROOT / 'tests/ros_nodes'}:/nodes:ro"],
        ),
    )["Id"]
    api.start(made)
    code = api.wait(made)["StatusCode"]
    said = api.logs(made).decode()
    api.remove_container(made)
    assert code == 0, said
    return out


@pytest.fixture(scope="session")
def cpp_programs(tmp_path_factory):
    """The C++ client's programs, static, so that they run in any container."""
    folder = tmp_path_factory.mktemp("cpp")
    for name in ("examples/tour", "tests/calls", "tests/latency"):
        subprocess.run(
            [
                "g++",
                "-std=c++17",
                "-O1",
                "-static",
                "-pthread",
                "-Wall",
                "-Wextra",
                "-Werror",
                "-I",
                ROOT / "clients/cpp/include",
                ROOT / f"clients/cpp/{name}.cpp",
                "-o",
                folder / name.partition("/")[2],
            ],
            check=True,
        )
    return folder


SANITIZERS = {
    "address": [
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
        # What the address sanitizer sees as well, and half of the compiler's time.
        "-fno-sanitize=null,alignment,object-size,vptr",
    ],
    "thread": ["-fsanitize=thread"],
}


@pytest.fixture(scope="session")
def sanitized(tmp_path_factory) -> dict[str, Path]:
    """The program of the C++ client's tests, once for each sanitizer, with TLS."""
    folder, client = tmp_path_factory.mktemp("sanitized"), ROOT / "clients/cpp"
    builds = [
        subprocess.Popen(
            [
                "g++",
                "-std=c++17",
                "-O1",
                "-g1",
                "-pthread",
                "-DRORG_WITH_TLS",
                *flags,
                "-I",
                client / "include",
                client / "tests/calls.cpp",
                "-o",
                folder / name,
                "-lssl",
                "-lcrypto",
            ]
        )
        for name, flags in SANITIZERS.items()
    ]
    assert [build.wait() for build in builds] == [0, 0]
    return {name: folder / name for name in SANITIZERS}


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


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    outcome = yield
    if call.when == "call" and outcome.get_result().passed:
        names = set(item.fixturenames)
        kind = (
            item.callspec.params.get("robot") or item.callspec.params.get("real_robot")
            if hasattr(item, "callspec")
            else None
        )
        if kind is None:
            kind = "docker" if names & {"dockerd", "docker_robot"} else "no engine"
        _ran[kind] += 1


def pytest_terminal_summary(terminalreporter):
    path = os.environ.get("RORG_TEST_FAILED")
    failed = {r.nodeid for kind in ("failed", "error") for r in terminalreporter.stats.get(kind, ())}
    if path and failed:
        Path(path).write_text("".join(f"{name}\n" for name in sorted(failed)))
    counts = ", ".join(f"{_ran[k]} on {k}" for k in ("docker", "process", "sim") if _ran[k])
    terminalreporter.write_line(f"tests passed by engine: {counts or 'none'}; {_ran['no engine']} need no engine")
    if not _ran["docker"]:
        terminalreporter.write_line("NO TEST RAN ON DOCKER", red=True, bold=True)
