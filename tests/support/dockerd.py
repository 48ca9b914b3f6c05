"""Docker engines for the tests: a private daemon, or one that somebody else runs."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pwd
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import psutil
from common import BASE_IMAGE, ROOT, no_docker, wait_for

ENOUGH = (4 << 30) * max(3, int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 1)))
"""Bytes of memory with which images are kept in memory. Each worker has an engine: with ROS 1, 2.1 GB were measured."""


def _most(number: int, enough: int) -> int:
    hard = resource.getrlimit(number)[1]
    return enough if hard == resource.RLIM_INFINITY else min(hard, enough)


def memory() -> int:
    """Bytes that may be had, on the machine and in our control group."""
    limits = [psutil.virtual_memory().available]
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        path = Path("/sys/fs/cgroup") / name
        if path.exists() and (text := path.read_text().strip()).isdigit():
            limits.append(int(text))
    return min(limits)


def lock_address_pool() -> tuple[int, str] | None:
    """A range of addresses that no other private daemon of this machine has while the descriptor is open, out of those
    that RFC 2544 sets aside for tests. Daemons that make networks at the same moment would choose the same subnet."""
    for number in range(32):
        lock = os.open(f"/tmp/rorg-tests-addresses-{number}.lock", os.O_CREAT | os.O_WRONLY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        return lock, f"base=198.{18 + number // 16}.{number % 16 * 16}.0/20,size=26"
    return None


def clean_up() -> None:
    """Removes what sessions left that were killed."""
    for owner in Path("/tmp").glob("rorg-dockerd.*/owner"):
        if not psutil.pid_exists(int(owner.read_text() or 0)):
            Dockerd.clean(owner.parent)


class Dockerd:
    """A private daemon that can be killed and started again."""

    title = "Docker 20.10"
    podman = False
    survives = False
    """Containers go on while the engine is away."""
    options: Sequence[str] = ()
    """More words of its command line."""

    @staticmethod
    def missing() -> str:
        """Why it cannot be started here."""
        return "" if os.geteuid() == 0 and shutil.which("dockerd") else "no dockerd to start as root"

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.host = f"unix://{folder}/docker.sock"
        self.process: subprocess.Popen | None = None
        self.addresses = lock_address_pool()
        (folder / "owner").write_text(str(os.getpid()))
        (folder / "data").mkdir()
        if memory() > ENOUGH:  # gigabytes of small files, written durably for nothing and removed one by one
            what = ["mount", "-t", "tmpfs", "-o", "size=8g", "rorg-tests", folder / "data"]
            subprocess.run(what, check=False, stderr=subprocess.DEVNULL)

    def start(self) -> None:
        # A runtime whose containers do not start while the file `hold` is there. Another is called as that of GPUs.
        hang = self.folder / "hang"
        wait = f"while [ -e {self.folder}/hold ]; do sleep 0.05; done"
        hang.write_text(f'#!/bin/sh\ncase " $* " in *" start "*) {wait};; esac\nexec runc "$@"\n')
        hang.chmod(0o755)
        # It ends with us, however we end: `setpriv` becomes the engine, and is told when its parent is no more.
        tied = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []
        log = (self.folder / "dockerd.log").open("ab")
        self.process = subprocess.Popen(
            [*self.as_user(), *tied, *self.command(hang)],
            stdout=log,
            stderr=log,
            start_new_session=True,
            cwd="/",
            env=self.environment(),
        )
        wait_for(self.answers, 60, f"dockerd, see {self.folder}/dockerd.log")

    def command(self, hang: Path) -> list[str]:
        return [
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
            "--add-runtime",
            "nvidia=runc",
            *(("--default-address-pool", self.addresses[1]) if self.addresses else ()),
            *self.options,
        ]

    def as_user(self) -> list[str]:
        """The beginning of a command that runs as another user."""
        return []

    def environment(self) -> Mapping[str, str]:
        return os.environ

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
            self.process.wait(60)
            self.process = None
            pid = self.folder / "exec/containerd/containerd.pid"
            if pid.exists():
                # A killed daemon takes its containerd along, but not at once; the next one would wait for the dying.
                wait_for(lambda: not os.path.exists(f"/proc/{pid.read_text().strip()}"), 30, "containerd to end")
                pid.unlink()

    def close(self) -> None:
        """Leaves nothing of it on the machine."""
        self.stop()
        self.clean(self.folder)
        if self.addresses:
            os.close(self.addresses[0])
            self.addresses = None

    @staticmethod
    def clean(folder: Path) -> None:
        end_what_outlived(folder)
        mounts = [line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]
        for mount in sorted((m for m in mounts if m.startswith(f"{folder}/")), reverse=True):
            subprocess.run(["umount", "-l", mount], check=False)
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def own_dockerd(*options: str) -> Iterator[Dockerd]:
    """A daemon for one test, with more words on its command line."""
    if why := Dockerd.missing():
        no_docker(why)
    daemon = Dockerd(Path(subprocess.check_output(["mktemp", "-d", "/tmp/rorg-dockerd.XXXXXX"], text=True).strip()))
    daemon.options = options
    try:
        daemon.start()
        import_base(daemon.host)
        yield daemon
    finally:
        daemon.close()


def end_what_outlived(folder: Path) -> None:
    """Ends containers that an engine which was killed has left behind. The shims that hold them name its folder."""
    for process in psutil.process_iter(["cmdline"]):
        if any(word.startswith(f"{folder}/") for word in process.info["cmdline"] or ()):
            with contextlib.suppress(psutil.NoSuchProcess):
                for left in [*process.children(recursive=True), process]:
                    with contextlib.suppress(psutil.NoSuchProcess):
                        left.kill()


class NewerDocker(Dockerd):
    """Docker 26 of Debian's next release, unpacked by tests/support/newer_docker.sh."""

    title = "Docker 26"
    folder_of_programs = ROOT / ".venv/docker26"
    features: Mapping[str, bool] = {}

    @classmethod
    def missing(cls) -> str:
        place = cls.folder_of_programs
        return "" if (place / "complete").exists() else f"no Docker 26: tests/support/newer_docker.sh {place}"

    def command(self, hang: Path) -> list[str]:
        configuration = self.folder / "daemon.json"
        configuration.write_text(json.dumps({"features": self.features} if self.features else {}))
        _, *options = super().command(hang)
        return [
            str(self.folder_of_programs / "usr/sbin/dockerd"),
            *options,
            "--config-file",
            str(configuration),
            "--init-path",
            str(self.folder_of_programs / "usr/bin/tini-static"),
        ]

    def environment(self) -> Mapping[str, str]:
        programs = (str(self.folder_of_programs / name) for name in ("usr/bin", "usr/sbin"))
        return {**os.environ, "PATH": os.pathsep.join((*programs, os.environ["PATH"]))}


class ContainerdStore(NewerDocker):
    """The same with images in containerd's store."""

    title = "Docker 26, containerd's image store"
    features: Mapping[str, bool] = {"containerd-snapshotter": True}


class Podman(Dockerd):
    """Podman's service."""

    title = "Podman 4.3"
    podman = True
    survives = True

    @staticmethod
    def missing() -> str:
        return "" if os.geteuid() == 0 and shutil.which("podman") else "no podman to start as root"

    def command(self, hang: Path) -> list[str]:
        self.configure(hang)
        return [shutil.which("podman") or "podman", "system", "service", "--time", "0", self.host]

    def configure(self, hang: Path) -> None:
        """crun, the default runtime, does not start on a machine with both versions of control groups. Podman's own
        limits are higher than a sandbox allows."""
        known = {"nofile": (resource.RLIMIT_NOFILE, 20_000), "nproc": (resource.RLIMIT_NPROC, 32_768)}
        limits = [f'"{name}={most}:{most}"' for name, limit in known.items() if (most := _most(*limit))]
        (self.folder / "containers.conf").write_text(
            f"""[engine]
runtime = "runc"
cgroup_manager = "cgroupfs"
events_logger = "file"
tmp_dir = "{self.folder}/exec/tmp"
volume_path = "{self.folder}/data/volumes"
[engine.runtimes]
hang = ["{hang}"]
nvidia = ["{shutil.which("runc")}"]
[containers]
log_driver = "k8s-file"
default_ulimits = [{", ".join(limits)}]
[network]
network_backend = "netavark"
network_config_dir = "{self.folder}/exec/networks"
"""
        )
        # Docker takes a registry of this machine for a trusted one.
        (self.folder / "registries.conf").write_text('[[registry]]\nlocation = "127.0.0.1"\ninsecure = true\n')
        (self.folder / "storage.conf").write_text(
            f'[storage]\ndriver = "overlay"\ngraphroot = "{self.folder}/data"\nrunroot = "{self.folder}/exec/run"\n'
        )

    def environment(self) -> Mapping[str, str]:
        return {
            **os.environ,
            "CONTAINERS_CONF": f"{self.folder}/containers.conf",
            "CONTAINERS_STORAGE_CONF": f"{self.folder}/storage.conf",
            "CONTAINERS_REGISTRIES_CONF": f"{self.folder}/registries.conf",
        }


class RootlessPodman(Podman):
    """The same for a user of this machine, whose containers have no control groups."""

    title = "Podman 4.3, rootless"
    user = "rorg-rootless"

    @classmethod
    def missing(cls) -> str:
        try:
            pwd.getpwnam(cls.user)
        except KeyError:
            return f"no user {cls.user}"
        return Podman.missing()

    def command(self, hang: Path) -> list[str]:
        user = pwd.getpwnam(self.user)
        for name in ("data", "exec", "runtime", "home"):
            (self.folder / name).mkdir(exist_ok=True)
        command = super().command(hang)
        self.folder.chmod(0o755)
        for path in (self.folder, *self.folder.iterdir()):
            if path.name != "dockerd.log":
                os.chown(path, user.pw_uid, user.pw_gid)
        return command

    def as_user(self) -> list[str]:
        user = pwd.getpwnam(self.user)
        return ["setpriv", "--reuid", str(user.pw_uid), "--regid", str(user.pw_gid), "--init-groups"]

    def environment(self) -> Mapping[str, str]:
        """With a home of its own: Podman looks for running containers in the storage of the home, too."""
        own = {"HOME": f"{self.folder}/home", "XDG_RUNTIME_DIR": f"{self.folder}/runtime"}
        return {**super().environment(), **own, "USER": self.user}


ENGINES: Mapping[str, type[Dockerd]] = {
    "docker": Dockerd,
    "docker26": NewerDocker,
    "docker26-containerd": ContainerdStore,
    "podman": Podman,
    "podman-rootless": RootlessPodman,
}


def chosen() -> type[Dockerd]:
    return ENGINES[os.environ.get("RORG_TEST_ENGINE") or "docker"]


class Reachable(Dockerd):
    """An engine that somebody else runs: used as it is, never stopped."""

    def __init__(self, host: str) -> None:
        self.host = host


def reachable() -> Reachable:
    """The engine that answers here, else the test cannot run."""
    import docker

    try:
        api = docker.from_env(version="auto").api
        api.ping()
    except docker.errors.DockerException as error:
        no_docker(f"no dockerd to start as root, and none answers ({error})")
    return Reachable(api.base_url.replace("http+docker://localhost", "unix:///var/run/docker.sock"))


def import_base(host: str) -> None:
    import docker

    api = docker.APIClient(host, version="auto")
    if not api.images(BASE_IMAGE):
        made = subprocess.Popen([sys.executable, str(ROOT / "images/base/rootfs.py")], stdout=subprocess.PIPE)
        api.import_image(src=made.stdout, repository=BASE_IMAGE, stream_src=True)
        assert made.wait() == 0
