"""The disk that guests begin with: a Debian bookworm with its own kernel, systemd, Docker and Podman as they come, and
the Python packages that rorg's tests need. It stays in .venv/vm and is made again when what it is made of changes."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import debian
from common import ROOT

HOME = ROOT / ".venv/vm"
BASE = HOME / "base"
"""Has disk.img, vmlinuz, initrd and the key that opens the guest to ssh."""
SIZE = "8G"
"""Of the disk. It takes only as much as is in it."""
PACKAGES = (
    *("systemd", "systemd-sysv", "dbus", "dbus-user-session", "libpam-systemd", "udev", "kmod", "procps", "iproute2"),
    *("linux-image-cloud-amd64", "initramfs-tools", "zstd", "apparmor", "openssh-server", "iptables", "python3", "git"),
    *(
        "docker.io",
        "podman",
        "crun",
        "uidmap",
        "slirp4netns",
        "netavark",
        "aardvark-dns",
        "catatonit",
        "fuse-overlayfs",
    ),
)
TOOLS = {
    "qemu-system-x86_64": "qemu-system-x86",
    "debootstrap": "debootstrap",
    "mke2fs": "e2fsprogs",
    "ssh": "openssh-client",
}
TEST_TOOLS = ("pytest", "hypothesis", "jsonschema", "packaging", "protobuf")
UNWANTED = (
    *("apt-daily.timer", "apt-daily-upgrade.timer", "dpkg-db-backup.timer", "e2scrub_all.timer", "fstrim.timer"),
    *("podman-auto-update.timer", "podman-auto-update.service", "podman-restart.service", "podman.service"),
    *("podman.socket", "e2scrub_reap.service", "getty@tty1.service", "systemd-networkd-wait-online.service"),
)
"""Units that only take time at the boot of an emulated machine."""
PATIENCE = {
    "system.conf.d/emulated.conf": "[Manager]\nDefaultTimeoutStartSec=15min\nDefaultTimeoutStopSec=5min\n",
    "system/rorg.service.d/emulated.conf": "[Service]\nWatchdogSec=5min\n",
}
"""Below /etc/systemd. An emulated machine takes some twenty times as long as a real one, and more beside other work."""
NETWORK = "[Match]\nName=en*\n[Network]\nAddress=10.0.2.15/24\n"


def base() -> Path:
    """The folder of what guests begin with. Takes some minutes the first time."""
    debian.install_tools(TOOLS)
    wanted = debian.python_packages(TEST_TOOLS)
    current = debian.key(Path(__file__).read_text(), *wanted)
    complete = HOME / "base.complete"
    if not complete.exists() or complete.read_text() != current:
        complete.unlink(missing_ok=True)
        shutil.rmtree(BASE, ignore_errors=True)
        BASE.mkdir(parents=True)
        print("vm: making a Debian in .venv/vm; what is said is in .venv/vm/log", flush=True)
        with (HOME / "log").open("w") as log:
            make(BASE / "root", log.fileno(), wanted)
        complete.write_text(current)
    return BASE


def make(root: Path, log: int, wanted: list[str]) -> None:
    def run(*words: str | Path) -> None:
        environment = {**os.environ, "LC_ALL": "C.UTF-8"}
        subprocess.run(words, check=True, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment)

    names = ",".join(PACKAGES)
    run("debootstrap", "--variant=minbase", f"--include={names}", "bookworm", root, *debian.mirror())
    debian.install_python_packages(root / "opt/site", "amd64", wanted)
    for name in ("vmlinuz", "initrd.img"):
        shutil.copy(next((root / "boot").glob(f"{name}-*")), BASE / name)
    shutil.rmtree(root / "var/cache/apt/archives")
    shutil.rmtree(root / "var/lib/apt/lists")
    run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", BASE / "key")
    (root / "root/.ssh").mkdir(0o700, exist_ok=True)
    shutil.copy(BASE / "key.pub", root / "root/.ssh/authorized_keys")
    (root / "etc/hostname").write_text("robot\n")
    (root / "etc/systemd/network/guest.network").write_text(NETWORK)
    for name, text in PATIENCE.items():
        (root / "etc/systemd" / name).parent.mkdir(exist_ok=True)
        (root / "etc/systemd" / name).write_text(text)
    run("chroot", root, "systemctl", "enable", "systemd-networkd.service")
    run("chroot", root, "systemctl", "mask", *UNWANTED)
    run("mke2fs", "-q", "-t", "ext4", "-d", root, BASE / "disk.img", SIZE)
    shutil.rmtree(root)
