"""`driver` of a Service: its models, and the least privileges that its container needs for the hardware."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from rorg.manifest import option_checks as check
from rorg.manifest.fields import TEXT, Written, field, recreate, unchanging
from rorg.manifest.option_forms import Strict, Text
from rorg.model.devices import Device

REALTIME: dict[str, Any] = {
    "cap_add": ["SYS_NICE"],
    "ulimits": {"rtprio": {"soft": 99, "hard": 99}, "memlock": {"soft": -1, "hard": -1}},
}
"""Privileges of a control loop: a real-time priority and locked memory."""
CLASSES: tuple[tuple[str, str, str, tuple[int, ...]], ...] = (
    ("input", "/dev/input/", "/dev/input", (13,)),
    ("sound", "/dev/snd/", "/dev/snd", (116,)),
    ("usb", "/dev/bus/usb/", "/dev/bus/usb", (189,)),
    ("drm", "/dev/dri/", "/dev/dri", (226,)),
    ("tty", "/dev/serial/", "/dev", (166, 188)),
    ("tty", "/dev/ttyUSB", "/dev", (188,)),
    ("tty", "/dev/ttyACM", "/dev", (166,)),
    ("video4linux", "/dev/v4l/", "/dev", (81,)),
    ("video4linux", "/dev/video", "/dev", (81,)),
    ("i2c-dev", "/dev/i2c-", "/dev", (89,)),
    ("spidev", "/dev/spidev", "/dev", (153,)),
)
"""(Subsystem, prefix of paths, directory of its nodes, major numbers) of the classes to which Linux assigns fixed
numbers, in Documentation/admin-guide/devices.txt."""


def _number(value: object) -> object:
    """Refuses 0403 without quotes, which is another number in YAML."""
    if isinstance(value, int) and not isinstance(value, bool):
        raise ValueError(f"{value} must be quoted: four hexadecimal digits, as lsusb shows them, such as '0403'")
    return value.lower() if isinstance(value, str) else value


UsbId = Annotated[str, BeforeValidator(_number), Field(pattern=r"^[0-9a-f]{4}$"), Written("text")]
Attribute = Annotated[Text, Field(min_length=1, max_length=255, pattern=r"^[^,()\x00-\x1f]+$")]


class Udev(Strict):
    """Attributes of a device, independent of its name: `udevadm info -a /dev/NAME` shows them."""

    vendor: UsbId | None = field("Vendor id, of the USB or PCI device that it belongs to.", "0403")
    product: UsbId | None = field("Product id, of the USB or PCI device that it belongs to.", "6001")
    serial: Attribute | None = field("Serial number, to tell two of a kind apart.", "A9007Ux2")
    subsystem: Attribute | None = field("The class of its node.", "tty", unset="any")

    @model_validator(mode="after")
    def _some(self) -> Udev:
        if not (self.vendor or self.serial):
            raise ValueError("'vendor' or 'serial' is missing")
        return self


DevicePath = Annotated[str, check.DEVICE]


def _device(value: object) -> object:
    """Converts a text to a path; `source` is Compose's word for it."""
    if isinstance(value, dict) and "source" in value and "path" not in value:
        return {"path" if k == "source" else k: v for k, v in value.items()}
    return {"path": value} if isinstance(value, str) else value


class DriverDevice(Strict):
    """One device: by a stable path, or by its attributes."""

    path: DevicePath | None = field("A stable path.", "/dev/serial/by-id/usb-SICK_TiM551-if00")
    udev: Udev | None = field("Attributes of the device.", {"vendor": "0403", "product": "6001", "subsystem": "tty"})
    target: Annotated[str, check.PATH] | None = field(
        "Its path in the container. Required with `udev`.", "/dev/sick", unset="as on the machine"
    )
    permissions: Literal["r", "w", "m", "rw", "rm", "wm", "rwm"] | None = field(
        "Allowed access: r to read, w to write, m to make the node.", "rw", unset="rwm"
    )

    @model_validator(mode="after")
    def _one(self) -> DriverDevice:
        if (self.path is None) == (self.udev is None):
            raise ValueError("exactly one of path, udev must be given")
        if self.path is not None and ":" in self.path and (self.target or self.permissions):
            raise ValueError("'target' and 'permissions' are already in 'path'")
        return self

    def meant(self) -> Device:
        """The device as a value. A device that is written as one text keeps exactly that text."""
        udev = tuple(sorted(self.udev.model_dump(exclude_none=True).items())) if self.udev else ()
        path = (self.path or "").partition(":")[0]
        name = self.path or Device("", udev=udev).identity
        more = [self.target or (path if self.permissions else ""), self.permissions or ""]
        return Device(":".join([name, *filter(None, more)]), path, udev)


class Driver(Strict):
    """A service that talks to hardware. It gets only these devices and waits for a missing one. Restarting it by hand
    asks for confirmation."""

    devices: list[Annotated[DriverDevice, BeforeValidator(_device), Written("text | DriverDevice", TEXT)]] = recreate(
        "The devices, by stable paths: PATH, PATH:PATH_INSIDE, PATH:PATH_INSIDE:rwm; or {path, target, "
        "permissions}, or {udev: {vendor, product, serial, subsystem}, target, permissions}.",
        ["/dev/serial/by-id/usb-SICK_TiM551-if00:/dev/sick"],
        list,
    )
    unplugged: Literal["stop", "keep"] = unchanging(
        "When a device is unplugged: stop the service until the device is back, or keep it running.", "keep", "stop"
    )
    groups: list[Annotated[Text, check.GROUP]] | None = recreate(
        "Extra groups inside the container, such as dialout or video.", ["dialout"]
    )
    realtime: bool = recreate("SYS_NICE, rtprio 99 and unlimited memlock.", True, False)
    hotplug: bool = recreate(
        "The program handles plugging and unplugging itself: it sees the directory of the nodes and may use all "
        "devices of the class. rorg does not wait for them, and does not stop the service without them.",
        True,
        False,
    )

    @model_validator(mode="after")
    def _classes(self) -> Driver:
        for device in (d.meant() for d in self.devices if self.hotplug):
            if class_of(device) is None:
                known = ", ".join(dict.fromkeys(c[0] for c in CLASSES))
                raise ValueError(
                    f"with hotplug, {device} must be of a class that is numbered for good ({known}); for others write "
                    "device_cgroup_rules and volumes below container"
                )
            target = device.text.split(":")[1:2]
            if target and target[0] != device.path:
                raise ValueError(f"with hotplug, {device} cannot have another name in the container: drop the target")
        for one in self.devices:
            if one.udev and not one.target and not self.hotplug:
                raise ValueError("a device known by udev needs a 'target': what it is called in the container")
        return self


def class_of(device: Device) -> tuple[str, tuple[int, ...]] | None:
    """(Directory of nodes, major numbers) of a device's class; None if Linux does not assign fixed numbers to it."""
    subsystem = dict(device.udev).get("subsystem")
    classes = [c for c in CLASSES if (device.path.startswith(c[1]) if device.path else c[0] == subsystem)]
    return (classes[0][2], tuple(sorted({n for c in classes for n in c[3]}))) if classes else None


def hardware(driver: Driver | None, without_hardware: bool) -> dict[str, Any]:
    """The fields of a Service that follow from its driver, such as the devices that it waits for."""
    if driver is None:
        return {}
    waits = () if without_hardware or driver.hotplug else driver.devices
    return {"driver": True, "devices": tuple(d.meant() for d in waits), "unplugged": driver.unplugged}


def options_of(driver: Driver, without_hardware: bool) -> dict[str, Any]:
    """Container options of a driver: its devices, its groups, and real-time limits only on request."""
    devices = [device.meant().text for device in driver.devices]
    if without_hardware:
        targets = [device.target or (device.path or "").split(":")[:2][-1] for device in driver.devices]
        return {"devices": [f"/dev/null:{target}" for target in targets if target]} if any(targets) else {}
    options: dict[str, Any] = _classes_of(driver) if driver.hotplug else {"devices": devices} if devices else {}
    if driver.groups:
        options["group_add"] = list(driver.groups)
    return {**options, **REALTIME} if driver.realtime else options


def _classes_of(driver: Driver) -> dict[str, Any]:
    """All nodes of the devices' classes, mounted read-only so that the driver cannot create nodes."""
    directories, rules = dict[str, None](), dict[str, None]()
    for device in driver.devices:
        directory, majors = class_of(device.meant()) or ("", ())
        directories[directory] = None
        written = (device.path or "").split(":")[2:]
        permissions = device.permissions or (written[0] if written else "rw")
        rules.update(dict.fromkeys(f"c {major}:* {permissions}" for major in majors))
    if not rules:
        return {}
    shown = [d for d in directories if d == "/dev"] or list(directories)
    return {"device_cgroup_rules": list(rules), "volumes": [f"{d}:{d}:ro" for d in shown]}
