"""A guest that is a robot: the Debian package installed, an image, manifests where the unit looks for them, and a user
in rorg's group."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from common import BASE_IMAGE, ROOT, wait_for
from robots import write_tree
from vm import disk
from vm.guest import Guest

PERSON = "pilot"
"""A user in the group `rorg`."""
MANIFESTS = "/opt/robot/manifests"


def package() -> Path:
    """rorg's Debian package, of the sources as they are."""
    folder = disk.HOME / "package"
    for old in folder.glob("*.deb"):
        old.unlink()
    command = [sys.executable, ROOT / "images/rorg/deb/build.py", folder]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return next(folder.glob("*.deb"))


class Robot:
    def __init__(self, guest: Guest, services: dict[str, dict]) -> None:
        """Boots the guest and makes a robot of it."""
        self.guest = guest
        deb = package()
        guest.boot()
        self.copy_project()
        guest.sh(f"python3 /src/images/base/rootfs.py | docker import - {BASE_IMAGE}")
        guest.sh(f"useradd --create-home --shell /bin/sh {PERSON}")
        guest.put(deb, "/tmp/rorg.deb")
        guest.sh(f"dpkg -i /tmp/rorg.deb && usermod -aG rorg {PERSON}", 300)
        self.declare(services)
        guest.sh("systemctl start rorg", 300)
        wait_for(lambda: guest.run(f"runuser -u {PERSON} -- rorg get")[0] == 0, 300, "rorg to answer")

    def copy_project(self) -> None:
        """To /src, as it is in this folder."""
        with tempfile.TemporaryDirectory(prefix="rorg-vm-") as folder:
            tar, names = Path(folder) / "project.tar", Path(folder) / "names"
            listed = ("git", "-C", ROOT, "ls-files", "-z", "--cached", "--others", "--exclude-standard")
            names.write_bytes(subprocess.run(listed, check=True, capture_output=True).stdout)
            words = ("tar", "-C", ROOT, "--ignore-failed-read", "--null", "--files-from", names, "-cf", tar)
            subprocess.run(words, check=True)
            self.guest.put(tar, "/tmp/project.tar")
        self.guest.sh("mkdir -p /src && tar -C /src --no-same-owner -xf /tmp/project.tar")

    def declare(self, services: dict[str, dict]) -> None:
        with tempfile.TemporaryDirectory(prefix="rorg-vm-") as folder:
            tree = write_tree(Path(folder) / "manifests", services)
            self.guest.sh("mkdir -p /opt/robot")
            self.guest.put(tree, "/opt/robot")

    def rorg(self, words: str, seconds: float = 120.0) -> str:
        """What a command of the person says."""
        return self.guest.sh(f"runuser -u {PERSON} -- rorg {words}", seconds)

    def json(self, words: str) -> Any:
        """Its answer, without the notes on stderr."""
        return json.loads(self.rorg(f"{words} -o json 2>/dev/null"))

    def service(self, name: str) -> dict[str, Any]:
        return next(s for s in self.json("get") if s["service"] == name)

    def running(self) -> set[str]:
        return {service["service"] for service in self.json("get") if service["state"] == "running"}

    def becomes(self, name: str, state: str, seconds: float = 120.0) -> dict[str, Any]:
        return wait_for(lambda: (s := self.service(name))["state"] == state and s, seconds, f"{name} to be {state}")

    def events(self, words: str) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.rorg(f"events {words} -o json 2>/dev/null").splitlines()]

    def log(self) -> str:
        return self.guest.sh("journalctl -u rorg.service -o cat --no-pager")

    def control_group(self, name: str) -> str:
        """The folder of the service's control group."""
        pid = self.service(name)["pid"]
        line = self.guest.sh(f"cat /proc/{pid}/cgroup").strip()
        assert line.startswith("0::/"), line
        return f"/sys/fs/cgroup{line.removeprefix('0::')}"
