"""Finds the current node of a device on this machine, from directory entries and attributes in /sys; opens no
device."""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path

from rorg.model.devices import Device, Plugged

AGAIN = 1.0
"""Seconds between two checks whether directories of nodes have changed, which take a few microseconds each."""
WHOLE = 10.0
"""Seconds after which everything is checked, even if no directory has changed."""
GONE = "is not there"


def look(devices: Collection[Device], root: str = "/") -> dict[Device, Plugged]:
    """The present state of each device. `root` contains `dev` and `sys`."""
    return {device: _by_path(device.path, root) if device.path else _by_udev(device, root) for device in devices}


def elsewhere(devices: Collection[Device]) -> dict[Device, Plugged]:
    """The same if containers run on another machine: the engine finds paths there itself, but cannot find devices by
    udev attributes."""
    why = "cannot be looked for: the engine is on another machine"
    return {device: Plugged(problem=why) for device in devices if device.udev}


def _by_path(path: str, root: str) -> Plugged:
    place = os.path.join(root, path.lstrip("/"))
    try:
        stat_result = os.stat(place)
    except OSError:
        return Plugged(problem=GONE)
    if stat.S_ISDIR(stat_result.st_mode):
        return Plugged(path)
    if not (stat.S_ISCHR(stat_result.st_mode) or stat.S_ISBLK(stat_result.st_mode)):
        return Plugged(problem="is not a device")
    base = os.path.realpath(root)
    return Plugged("/" + os.path.relpath(os.path.realpath(place), base), _number(stat_result))


def _number(stat_result: os.stat_result) -> str:
    kind = "c" if stat.S_ISCHR(stat_result.st_mode) else "b"
    return f"{kind} {os.major(stat_result.st_rdev)}:{os.minor(stat_result.st_rdev)}"


def _by_udev(device: Device, root: str) -> Plugged:
    """The first of several nodes of one piece of hardware; several pieces are indistinguishable."""
    wanted, by_owner = dict(device.udev), dict[str, list[str]]()
    for folder in _all(root):
        name = _attribute(folder / "uevent", "DEVNAME=")
        owner = _owner(folder, wanted, root) if name else None
        if owner is not None:
            by_owner.setdefault(str(owner), []).append(f"/dev/{name}")
    if not by_owner:
        return Plugged(problem=GONE)
    if len(by_owner) > 1:
        names = ", ".join(sorted(min(nodes, key=_natural) for nodes in by_owner.values()))
        return Plugged(problem=f"is ambiguous: {names} match")
    (nodes,) = by_owner.values()
    own = [n for n in nodes if "subsystem" in wanted or not n.startswith("/dev/bus/")] or nodes
    return _by_path(min(own, key=_natural), root)


def _natural(name: str) -> tuple[int, str]:
    return len(name), name


def _all(root: str) -> Iterator[Path]:
    """The directories in /sys of all nodes."""
    for kind in ("char", "block"):
        folder = Path(root, "sys/dev", kind)
        yield from (sorted(folder.iterdir()) if folder.is_dir() else ())


def _owner(folder: Path, wanted: Mapping[str, str], root: str) -> Path | None:
    """The piece of hardware that a node belongs to, if it is the wanted one: the nearest directory above with a
    vendor."""
    if "subsystem" in wanted and _name(folder / "subsystem") != wanted["subsystem"]:
        return None
    top = Path(root, "sys/devices").resolve()
    place = folder.resolve()
    while place != top and top in place.parents:
        vendor = _attribute(place / "idVendor") or _attribute(place / "vendor").removeprefix("0x")
        if vendor:
            product = _attribute(place / "idProduct") or _attribute(place / "device").removeprefix("0x")
            said = {"vendor": vendor.lower(), "product": product.lower(), "serial": _attribute(place / "serial")}
            return place if all(said.get(k, v) == v for k, v in wanted.items()) else None
        place = place.parent
    return None


def _name(link: Path) -> str:
    try:
        return os.path.basename(os.readlink(link))
    except OSError:
        return ""


def _attribute(path: Path, prefix: str = "") -> str:
    """The line of an attribute that begins with `prefix`, without that; empty if there is none."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace")[:4096].splitlines()
    except OSError:
        return ""
    return next((line.removeprefix(prefix).strip() for line in lines if line.startswith(prefix)), "")


class DeviceWatch:
    """Checks devices in a thread of its own, and wakes the loop when one has come or gone. The kernel does not report
    every change of a node, so their directories are checked, which costs almost nothing as long as they are
    unchanged."""

    def __init__(self, wake: Callable[[], None], root: str = "/") -> None:
        self.wake, self.root = wake, root
        self._devices: tuple[Device, ...] = ()
        self._found: Mapping[Device, Plugged] = {}
        self._seen: tuple[tuple[str, int], ...] = ()
        self._moving = False
        """Whether a directory had changed at the last check."""
        self._lock = threading.Lock()
        self._asked, self._stop = threading.Event(), threading.Event()

    def start(self) -> None:
        threading.Thread(target=self._run, name="devices", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()
        self._asked.set()

    def of(self, devices: tuple[Device, ...]) -> Mapping[Device, Plugged]:
        """The present ones of these, at most a second ago; the same object as long as nothing has changed."""
        if devices != self._devices:
            self._devices = devices
            self._look()
            self._asked.set()
        return self._found

    def _run(self) -> None:
        since = 0.0
        while not self._stop.is_set():
            if not self._devices:
                self._asked.wait()
                self._asked.clear()
                continue
            self._stop.wait(AGAIN)
            since += AGAIN
            if not self._stop.is_set() and (self._moved() or since >= WHOLE):
                since = 0.0
                if self._look():
                    self.wake()

    def _moved(self) -> bool:
        """Whether a directory of nodes has changed. Times are coarse, so a changed one is checked twice."""
        folders = {os.path.join(self.root, "dev")}
        for device in self._devices:
            path = os.path.dirname(os.path.join(self.root, device.path.lstrip("/")))
            folders |= {path} if device.path else {os.path.join(self.root, "sys/dev/char")}
        seen = tuple((folder, _changed_at(folder)) for folder in sorted(folders))
        moved, again = seen != self._seen, self._moving
        self._seen, self._moving = seen, moved
        return moved or again

    def _look(self) -> bool:
        """Whether any device has changed."""
        with self._lock:
            plugged = look(self._devices, self.root)
            if plugged == self._found:
                return False
            self._found = plugged
            return True


def _changed_at(folder: str) -> int:
    try:
        return os.stat(folder).st_mtime_ns
    except OSError:
        return 0
