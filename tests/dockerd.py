"""Docker engines for the tests: a private daemon, or one that somebody else runs."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import psutil
from conftest import BASE_IMAGE, ROOT, no_docker, wait_for

ENOUGH = 12 << 30
"""Bytes of memory with which images are kept in memory."""


def memory() -> int:
    """Bytes that may be had, on the machine and in our control group."""
    limits = [psutil.virtual_memory().available]
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        path = Path("/sys/fs/cgroup") / name
        if path.exists() and (text := path.read_text().strip()).isdigit():
            limits.append(int(text))
    return min(limits)


def clean_up() -> None:
    """Removes what sessions left that were killed."""
    for owner in Path("/tmp").glob("rorg-dockerd.*/owner"):
        if not psutil.pid_exists(int(owner.read_text() or 0)):
            Dockerd.clean(owner.parent)


class Dockerd:
    """A private daemon that can be killed and started again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.host = f"unix://{folder}/docker.sock"
        self.process: subprocess.Popen | None = None
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
        # It ends with us, however we end: `setpriv` becomes dockerd, and is told when its parent is no more.
        tied = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []
        log = (self.folder / "dockerd.log").open("ab")
        self.process = subprocess.Popen(
            [
                *tied,
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

    @staticmethod
    def clean(folder: Path) -> None:
        end_what_outlived(folder)
        mounts = [line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]
        for mount in sorted((m for m in mounts if m.startswith(f"{folder}/")), reverse=True):
            subprocess.run(["umount", "-l", mount], check=False)
        shutil.rmtree(folder, ignore_errors=True)


def end_what_outlived(folder: Path) -> None:
    """Ends containers that an engine which was killed has left behind. The shims that hold them name its folder."""
    for process in psutil.process_iter(["cmdline"]):
        if any(word.startswith(f"{folder}/") for word in process.info["cmdline"] or ()):
            with contextlib.suppress(psutil.NoSuchProcess):
                for left in [*process.children(recursive=True), process]:
                    with contextlib.suppress(psutil.NoSuchProcess):
                        left.kill()


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
