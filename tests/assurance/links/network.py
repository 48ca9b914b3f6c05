"""Three computers on this machine: a network namespace for each, joined by a bridge in a further one. Links are cut
and made lossy by iptables, since not every kernel has netem."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Collection
from typing import TYPE_CHECKING

import psutil

if TYPE_CHECKING:
    from dockerd import Dockerd

PREFIX = "rorg-t"


def run(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")


def processes_of(engine: Dockerd) -> list[psutil.Process]:
    """An engine, and all that it runs."""
    assert engine.process is not None
    own = psutil.Process(engine.process.pid)
    shims = [p for p in psutil.process_iter(["cmdline"]) if str(engine.folder) in " ".join(p.info["cmdline"] or ())]
    found = [own, *own.children(recursive=True), *(p for s in shims for p in (s, *s.children(recursive=True)))]
    return list({p.pid: p for p in found}.values())


class Network:
    """Namespaces with the addresses 10.87.0.1 and up; close() removes them."""

    def __init__(self, names: Collection[str]) -> None:
        self.addresses = {name: f"10.87.0.{number}" for number, name in enumerate(names, 1)}
        self._spaces = {name: f"{PREFIX}{os.getpid()}-{name}" for name in [*names, "hub"]}
        for space in self._spaces.values():
            run("ip", "netns", "add", space)
        hub = self.enter("hub")
        run(*hub, "ip", "link", "add", "br0", "type", "bridge")
        run(*hub, "ip", "link", "set", "br0", "up")
        for name, address in self.addresses.items():
            inside, outside, port = self.enter(name), self._spaces["hub"], f"p-{name}"
            run(*inside, "ip", "link", "add", "eth0", "type", "veth", "peer", "name", port, "netns", outside)
            run(*inside, "ip", "addr", "add", f"{address}/24", "dev", "eth0")
            for link in ("lo", "eth0"):
                run(*inside, "ip", "link", "set", link, "up")
            run(*hub, "ip", "link", "set", port, "master", "br0", "up")

    def enter(self, name: str) -> tuple[str, ...]:
        """The beginning of a command that runs on this computer. `ip netns exec` would hide the control groups."""
        return ("nsenter", f"--net=/run/netns/{self._spaces[name]}")

    def cut(self, sender: str, receiver: str) -> None:
        """Nothing passes in this direction any more."""
        run(*self.enter(receiver), "iptables", "-A", "INPUT", "-s", self.addresses[sender], "-j", "DROP")

    def lose(self, name: str, part: float) -> None:
        """A computer loses this part of the packets that come in."""
        words = ("-m", "statistic", "--mode", "random", "--probability", str(part), "-j", "DROP")
        run(*self.enter(name), "iptables", "-A", "INPUT", "-i", "eth0", *words)

    def heal(self) -> None:
        for name in self.addresses:
            run(*self.enter(name), "iptables", "-F", "INPUT")

    def close(self) -> None:
        for space in self._spaces.values():
            subprocess.run(["ip", "netns", "del", space], capture_output=True)
