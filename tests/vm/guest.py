"""A whole machine that qemu emulates: boot it, run commands on it, copy files to it, restart it, cut its power."""

from __future__ import annotations

import contextlib
import shlex
import shutil
import signal
import subprocess
import time
from pathlib import Path

import disk
from conftest import free_port, wait_for

BOOT = 400.0
"""Seconds for a boot, on a machine that has other work too. Alone it takes some 40."""
CORES, MEMORY = 2, 4096


class Guest:
    """Its files are in .venv/vm/NAME. It ends, as by a power cut, with the process that boots it."""

    def __init__(self, name: str) -> None:
        """Off, with a fresh disk."""
        self.base = disk.base()
        self.folder = disk.HOME / name
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        subprocess.run(["cp", "--sparse=always", self.base / "disk.img", self.folder], check=True)
        self.qemu: subprocess.Popen | None = None
        self.port = 0

    def boot(self) -> None:
        """Returns when systemd has started everything."""
        self.port = free_port()
        tied = ["setpriv", "--pdeathsig", "KILL"]
        with (self.folder / "qemu.log").open("ab") as log:
            self.qemu = subprocess.Popen([*tied, *self.command()], stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        self.wait_for_boot("")

    def command(self) -> list[str]:
        """KVM is left out: nested, it is often missing or broken. The drive does without this machine's page cache, so
        what the guest has flushed is all that a power cut must leave."""
        return [
            *("qemu-system-x86_64", "-accel", "tcg,thread=multi", "-smp", f"{CORES}", "-m", f"{MEMORY}"),
            *("-display", "none", "-monitor", "none", "-serial", f"file:{self.folder}/console.log"),
            *("-kernel", f"{self.base}/vmlinuz", "-initrd", f"{self.base}/initrd.img"),
            *("-append", "console=ttyS0 root=/dev/vda rw quiet panic=-1 mitigations=off"),
            *("-drive", f"file={self.folder}/disk.img,if=virtio,format=raw,cache=none"),
            *("-netdev", f"user,id=net,restrict=on,hostfwd=tcp:127.0.0.1:{self.port}-:22"),
            *("-device", "virtio-net-pci,netdev=net,romfile="),
        ]

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
        """The exit code and the output of a script; 255 if the guest does not answer. TimeoutExpired if it is not over
        within this time."""
        process = self.popen(script)
        try:
            output, _ = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise
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

    def boot_id(self) -> str:
        """Names the boot; "" if the guest does not answer."""
        assert self.qemu is not None
        assert self.qemu.poll() is None, self.last_words()
        with contextlib.suppress(subprocess.TimeoutExpired):
            code, output = self.run("cat /proc/sys/kernel/random/boot_id", 15.0)
            return output.strip() if code == 0 else ""
        return ""

    def wait_for_boot(self, before: str) -> None:
        """Until another boot than this one is complete."""
        began = time.monotonic()
        try:
            wait_for(lambda: self.boot_id() not in ("", before), BOOT, "the guest to answer")
            self.run("systemctl is-system-running --wait", BOOT)
        except (AssertionError, subprocess.TimeoutExpired) as error:
            raise AssertionError(f"{error}\n{self.last_words()}") from error
        print(f"vm: booted in {time.monotonic() - began:.0f} s", flush=True)

    def last_words(self) -> str:
        files = [self.folder / name for name in ("console.log", "qemu.log")]
        return "\n".join(f"{f}:\n{f.read_text(errors='replace')[-3000:]}" for f in files if f.exists())

    def reboot(self) -> None:
        """As a person does it; returns after the next boot."""
        before = self.boot_id()
        self.run("systemctl reboot")
        self.disconnect()
        self.wait_for_boot(before)

    def cut(self) -> None:
        """Cuts the power."""
        if self.qemu is not None:
            self.qemu.send_signal(signal.SIGKILL)
            self.qemu.wait(60)
            self.qemu = None
        self.disconnect()

    def disconnect(self) -> None:
        subprocess.run([*self.ssh(), "-O", "exit", "root@127.0.0.1"], cwd=self.folder, capture_output=True, timeout=30)

    def close(self) -> None:
        """Its messages stay for who looks for a failure."""
        self.cut()
        (self.folder / "disk.img").unlink(missing_ok=True)
