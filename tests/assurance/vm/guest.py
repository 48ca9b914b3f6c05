"""A whole machine that qemu emulates: boot it, run commands on it, copy files to it, restart it, cut its power."""

from __future__ import annotations

import contextlib
import random
import shlex
import shutil
import signal
import subprocess
import time
from pathlib import Path

from common import free_port, wait_for
from vm import disk
from vm.disk_cache import replay

BOOT = 900.0
"""Seconds for a boot at most: on a machine with much other work it takes minutes."""
CORES, MEMORY = 2, 4096


class Guest:
    """Its files are in .venv/vm/NAME. It ends, as by a power cut, with the process that boots it."""

    def __init__(self, name: str) -> None:
        """Off, with a fresh disk."""
        self.base = disk.base()
        self.folder = disk.HOME / name
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        self.disk, self.before, self.log = (self.folder / name for name in ("disk.img", "before.img", "writes.log"))
        self.write_cache = False
        copy(self.base / "disk.img", self.disk)
        self.qemu: subprocess.Popen | None = None
        self.port = 0

    def boot(self, write_cache: bool = False) -> None:
        """Returns when systemd has started everything. With `write_cache`, a cut loses what was not flushed to the
        disk."""
        self.port, self.write_cache = free_port(), write_cache
        if self.write_cache:
            copy(self.disk, self.before)
            self.log.write_bytes(b"")
        tied = ["setpriv", "--pdeathsig", "KILL"]
        with (self.folder / "qemu.log").open("ab") as log:
            self.qemu = subprocess.Popen([*tied, *self.command()], stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        began = time.monotonic()
        try:
            wait_for(self.answers, BOOT, "the guest to answer")
            self.run("systemctl is-system-running --wait", BOOT)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.last_words()}") from error
        print(f"vm: booted in {time.monotonic() - began:.0f} s", flush=True)

    def command(self) -> list[str]:
        """KVM is left out: nested, it is often missing or broken."""
        return [
            *("qemu-system-x86_64", "-accel", "tcg,thread=multi", "-smp", f"{CORES}", "-m", f"{MEMORY}"),
            *("-display", "none", "-monitor", "none", "-no-reboot", "-serial", f"file:{self.folder}/console.log"),
            *("-kernel", f"{self.base}/vmlinuz", "-initrd", f"{self.base}/initrd.img"),
            *("-append", "console=ttyS0 root=/dev/vda rw quiet panic=-1 mitigations=off"),
            *self.drive(),
            *("-netdev", f"user,id=net,restrict=on,hostfwd=tcp:127.0.0.1:{self.port}-:22"),
            *("-device", "virtio-net-pci,netdev=net,romfile="),
        ]

    def drive(self) -> list[str]:
        """The disk, and with a write cache also the log of what is written to it. This machine's page cache outlives
        qemu, so qemu need not flush it."""
        option = "driver=file,cache.no-flush=on,discard=ignore"
        words = ["-blockdev", f"node-name=disk,filename={self.disk},{option}"]
        if not self.write_cache:
            return [*words, "-device", "virtio-blk-pci,drive=disk"]
        words += ["-blockdev", f"node-name=log,filename={self.log},{option}"]
        words += ["-blockdev", "node-name=logged,driver=blklogwrites,file=disk,log=log"]
        return [*words, "-device", "virtio-blk-pci,drive=logged"]

    def ssh(self, program: str = "ssh") -> list[str]:
        """One connection for all commands: to make one takes a second."""
        options = {
            "BatchMode": "yes",
            "StrictHostKeyChecking": "no",
            "UserKnownHostsFile": "/dev/null",
            "LogLevel": "ERROR",
            "ConnectTimeout": "10",
            "ControlMaster": "auto",
            "ControlPath": "connection",  # in the folder, whose own path may be too long for a socket
            "ControlPersist": "yes",
            "Port": f"{self.port}",
            "IdentityFile": f"{self.base}/key",
        }
        return [program, *(word for key, value in options.items() for word in ("-o", f"{key}={value}"))]

    def popen(self, script: str) -> subprocess.Popen:
        """Begins a script of root's shell there; its output is a pipe here."""
        command = [*self.ssh(), "root@127.0.0.1", f"sh -ec {shlex.quote(script)}"]
        return subprocess.Popen(
            command,
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(self, script: str, seconds: float = 120.0) -> tuple[int, str]:
        """The exit code and the output of a script that ends within this time; 255 if the guest does not answer."""
        process = self.popen(script)
        try:
            output, _ = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            output, _ = process.communicate()
            raise AssertionError(f"not within {seconds} s: {script}\n{output}") from None
        return process.returncode, output

    def sh(self, script: str, seconds: float = 120.0) -> str:
        """The output of a script that succeeds."""
        code, output = self.run(script, seconds)
        assert code == 0, f"exit code {code} of: {script}\n{output}"
        return output

    def put(self, source: Path, target: str) -> None:
        """Copies a file, or a folder with what is in it."""
        command = [*self.ssh("scp"), "-r", str(source.resolve()), f"root@127.0.0.1:{target}"]
        subprocess.run(command, cwd=self.folder, check=True, stdin=subprocess.DEVNULL, timeout=300)

    def answers(self) -> bool:
        assert self.qemu is not None
        assert self.qemu.poll() is None, "qemu has ended"
        with contextlib.suppress(AssertionError):
            return self.run("true", 15.0)[0] == 0
        return False

    def last_words(self) -> str:
        files = [self.folder / name for name in ("console.log", "qemu.log")]
        return "\n".join(f"{f}:\n{f.read_text(errors='replace')[-3000:]}" for f in files if f.exists())

    def power_off(self, verb: str = "poweroff") -> None:
        """As a person does it, with systemctl."""
        assert self.qemu is not None
        self.run(f"systemctl {verb}")
        self.qemu.wait(BOOT)
        self.qemu = None
        self.disconnect()

    def reboot(self) -> None:
        """Returns after the next boot. qemu itself begins anew: after a reset it emulates several times slower."""
        self.power_off("reboot")
        self.boot()

    def cut(self, kept: float = 0.0) -> None:
        """Cuts the power. A write that was not flushed to the disk reaches it with the probability `kept`."""
        if self.qemu is None:
            return
        self.qemu.send_signal(signal.SIGKILL)
        self.qemu.wait(60)
        self.qemu = None
        self.disconnect()
        if self.write_cache:
            later, lost = replay(self.log, self.before, random.Random(), kept)
            print(f"vm: {lost} of {later} writes that were not flushed are lost", flush=True)
            self.before.replace(self.disk)

    def disconnect(self) -> None:
        subprocess.run([*self.ssh(), "-O", "exit", "root@127.0.0.1"], cwd=self.folder, capture_output=True, timeout=30)

    def close(self) -> None:
        """Its messages stay for who looks for a failure."""
        self.cut()
        for path in (self.disk, self.before, self.log):
            path.unlink(missing_ok=True)


def copy(source: Path, target: Path) -> None:
    """Copies a disk; what is empty takes no space."""
    subprocess.run(["cp", "--sparse=always", source, target], check=True)
