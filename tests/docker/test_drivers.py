"""Drivers and their devices: found by path or by what they say of themselves, waited for, and followed wherever they
are plugged in."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest
from common import wait_for
from robots import VirtualRobot, write_tree

from rorg.errors import Invalid
from rorg.host.devices import DeviceWatch, elsewhere, look
from rorg.manifest.driver import Driver, options_of
from rorg.manifest.load import load, load_or_raise
from rorg.manifest.validation.machine import check_machine
from rorg.model.catalog import Catalog, Group, Idle, Service
from rorg.model.devices import Device, Plugged
from rorg.model.former import Former, Kept
from rorg.model.machine import Machine as Facts
from rorg.model.probe import Probe
from rorg.store.last_good import read_kept, write_kept

root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root makes device nodes")
GONE, THERE = Plugged(problem="is not there"), Plugged("/dev/ttyUSB0", "c 188:0")
LASER = "/dev/serial/by-id/laser"


class Machine:
    """A tree with `dev` and `sys` as the kernel and udev keep them."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for folder in ("dev/serial/by-id", "sys/dev/char", "sys/dev/block", "sys/devices"):
            (root / folder).mkdir(parents=True)

    def node(self, name: str, major: int, minor: int) -> Path:
        path = self.root / "dev" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        os.mknod(path, stat.S_IFCHR | 0o660, os.makedev(major, minor))
        return path

    def plug(
        self, port: str, name: str, minor: int, subsystem: str = "tty", major: int = 188, **attributes: str
    ) -> None:
        """A USB device at a port, with a node of this name."""
        self.node(name, major, minor)
        usb = self.root / "sys/devices/pci0/usb1" / port
        place = usb / f"{port}:1.0" / name.replace("/", "!")
        place.mkdir(parents=True, exist_ok=True)
        for attribute, value in attributes.items():
            (usb / attribute).write_text(f"{value}\n")
        (place / "uevent").write_text(f"MAJOR={major}\nMINOR={minor}\nDEVNAME={name}\n")
        (self.root / "sys/class" / subsystem).mkdir(parents=True, exist_ok=True)
        (place / "subsystem").symlink_to(f"../../../../../../class/{subsystem}")
        (self.root / f"sys/dev/char/{major}:{minor}").symlink_to(os.path.relpath(place, self.root / "sys/dev/char"))

    def unplug(self, name: str) -> None:
        (self.root / "dev" / name).unlink()
        for link in (self.root / "sys/dev/char").iterdir():
            if f"DEVNAME={name}\n" in (link / "uevent").read_text():
                link.unlink()

    def found(self, device: Device) -> Plugged:
        return look([device], str(self.root))[device]


def by_path(path: str) -> Device:
    return Device(path, path)


def by_udev(**attributes: str) -> Device:
    return Device("udev:/dev/x", udev=tuple(sorted(attributes.items())))


@pytest.fixture
def machine(tmp_path):
    return Machine(tmp_path)


@root_only
def test_a_path_leads_to_the_node_that_it_names_now(machine):
    assert machine.found(by_path(LASER)).problem == "is not there"
    machine.node("ttyUSB3", 188, 3)
    link = machine.root / LASER.lstrip("/")
    link.symlink_to("../../ttyUSB3")
    assert machine.found(by_path(LASER)) == Plugged("/dev/ttyUSB3", "c 188:3")
    link.unlink()
    link.symlink_to("../../gone")
    assert machine.found(by_path(LASER)).problem == "is not there"


def test_a_file_is_no_device_and_a_directory_of_nodes_is(machine):
    (machine.root / "dev/file").write_text("")
    assert machine.found(by_path("/dev/file")).problem == "is not a device"
    assert machine.found(by_path("/dev/serial")) == Plugged("/dev/serial")


@root_only
def test_a_device_is_known_by_what_the_hardware_above_it_says(machine):
    ftdi = {"idVendor": "0403", "idProduct": "6001"}
    machine.plug("1-1", "ttyUSB0", 0, **ftdi, serial="left")
    machine.plug("1-2", "ttyUSB1", 1, **ftdi, serial="right")
    assert machine.found(by_udev(vendor="0403", serial="right")) == Plugged("/dev/ttyUSB1", "c 188:1")
    both = machine.found(by_udev(vendor="0403", product="6001"))
    assert both.problem == "is ambiguous: /dev/ttyUSB0, /dev/ttyUSB1 match"
    assert machine.found(by_udev(vendor="0403", product="6002")).problem == "is not there"
    assert machine.found(by_udev(vendor="0403", serial="left", subsystem="input")).problem == "is not there"


@root_only
def test_of_several_nodes_of_one_device_the_first_one_of_its_class_counts(machine):
    camera = {"idVendor": "046d", "idProduct": "0825"}
    machine.plug("1-3", "video10", 10, "video4linux", 81, **camera)
    machine.plug("1-3", "video2", 2, "video4linux", 81, **camera)
    machine.plug("1-3", "bus/usb/001/004", 3, "usb", 189, **camera)
    assert machine.found(by_udev(vendor="046d")).node == "/dev/video2"
    assert machine.found(by_udev(vendor="046d", subsystem="usb")).node == "/dev/bus/usb/001/004"


@pytest.mark.slow
@root_only
def test_the_watch_wakes_when_a_device_comes_or_goes_and_only_then(machine):
    device, wakes = by_udev(vendor="0403"), []
    watch = DeviceWatch(lambda: wakes.append(1), str(machine.root))
    watch.start()
    try:
        assert watch.of((device,))[device].problem == "is not there"
        machine.node("null", 1, 3)
        machine.plug("1-1", "ttyUSB0", 0, idVendor="0403")
        wait_for(lambda: watch.of((device,))[device] == Plugged("/dev/ttyUSB0", "c 188:0"))
        machine.unplug("ttyUSB0")
        wait_for(lambda: watch.of((device,))[device].problem == "is not there")
        wait_for(lambda: len(wakes) == 2)
        assert watch.of((device,)) is watch.of((device,)), "a pass sees at once that nothing is otherwise"
    finally:
        watch.stop()


def test_of_an_engine_on_another_machine_only_paths_are_known():
    device = by_udev(vendor="0403")
    assert "another machine" in elsewhere([device, by_path("/dev/x")])[device].problem
    assert by_path("/dev/x") not in elsewhere([device, by_path("/dev/x")])


# -- a whole robot, in virtual time ----------------------------------------------------------------------------


@pytest.fixture
def robot(tmp_path):
    return VirtualRobot(tmp_path)


def laser(**more) -> dict:
    return {"laser": {"always_on": True, "driver": {"devices": [f"{LASER}:/dev/sick"], **more}}}


def test_absent_plugged_in_unplugged_and_plugged_in_elsewhere(robot):
    robot.declare({**laser(), "nav": {"always_on": True, "needs": ["laser"]}})
    robot.sim.engine.unplug(LASER)
    robot.wait(lambda: robot.waits("laser") == f"{LASER} is not there" and not robot.sim.memory.in_flight)
    assert robot.active() == set()
    assert "laser" in robot.waits("nav")
    robot.sim.engine.plug(LASER)
    robot.wait(lambda: robot.active() == {"laser", "nav"})
    robot.settle()
    first = robot.container("laser")
    robot.sim.engine.unplug(LASER)
    robot.wait(lambda: robot.states()["laser"] == "exited" and not robot.sim.memory.in_flight)
    robot.sim.engine.plug(LASER)
    robot.wait(lambda: "laser" in robot.active())
    assert robot.container("laser").id == first.id, "the same node is back"
    robot.settle()
    robot.sim.engine.plug(LASER, "/dev/ttyUSB1", "c 188:1")
    robot.wait(lambda: "laser" in robot.active() and robot.container("laser").id != first.id)
    robot.settle()
    assert [c.service for c in robot.containers()].count("laser") == 1
    assert "c 188:1 /dev/ttyUSB1" in robot.container("laser").devices


def test_one_that_is_kept_runs_on_and_starts_at_once_when_it_ended(robot):
    robot.declare(laser(unplugged="keep"))
    robot.sim.engine.plug(LASER)
    robot.wait(lambda: robot.active() == {"laser"})
    robot.settle()
    for _ in range(4):  # so that another try would wait for some seconds
        robot.kill("laser")
        robot.wait(lambda: robot.active() == {"laser"})
    run = robot.container("laser").incarnation
    robot.sim.engine.unplug(LASER)
    robot.settle()
    assert robot.container("laser").incarnation == run
    robot.kill("laser")  # as programs end that find their device gone
    robot.wait(lambda: robot.waits("laser") == f"{LASER} is not there")
    began = robot.now()
    robot.sim.engine.plug(LASER)
    robot.wait(lambda: robot.active() == {"laser"})
    assert robot.now() - began < 1.0, "nothing is waited for that failed without the device"


def test_what_does_not_come_up_at_another_node_is_not_held_against_its_manifest(robot):
    robot.declare(laser())
    robot.sim.engine.plug(LASER)
    robot.wait(lambda: robot.active() == {"laser"})
    robot.settle()
    robot.sim.faults.crash_after["laser"] = 0.1
    robot.sim.engine.plug(LASER, number="c 188:7")
    robot.wait(lambda: robot.sim.memory.of("laser").exits >= 2)
    assert robot.sim.memory.of("laser").update.failed == ""


def test_drivers_start_before_others_that_could_start_at_the_same_time(robot):
    names = {f"a{n}": {"always_on": True, "priority": 90} for n in range(6)}
    robot.declare({**names, "laser": {"always_on": True, "driver": {}, "priority": 10}})
    robot.settle()
    started = [line.split()[2] for line in robot.log() if line.startswith("> start")]
    assert started[0] == "laser"


# -- least privilege -------------------------------------------------------------------------------------------


def rendered(**driver) -> dict:
    return options_of(Driver.model_validate(driver), False)


def test_a_driver_gets_its_devices_and_nothing_more():
    assert rendered(devices=["/dev/ttyUSB0:/dev/base:rw"], groups=["dialout"]) == {
        "devices": ["/dev/ttyUSB0:/dev/base:rw"],
        "group_add": ["dialout"],
    }
    assert rendered(devices=[{"path": LASER, "permissions": "r"}]) == {"devices": [f"{LASER}:{LASER}:r"]}
    assert rendered() == {}


def test_profiles_that_are_asked_for_give_what_no_driver_is_needed_for(tmp_path):
    specs = {name: {"profile": name} for name in ("realtime", "gpu", "x11")} | {"all": {"profile": "mine"}}
    mine = {"extends": ["ros2", "realtime", "gpu", "x11"], "container": {"environment": {"DISPLAY": ":1"}}}
    found = load_or_raise(write_tree(tmp_path, specs, profiles={"mine": mine})).services
    assert found["realtime"].spec["cap_add"] == ["SYS_NICE"]
    assert found["realtime"].spec["ulimits"]["rtprio"] == {"soft": 99, "hard": 99}
    assert found["gpu"].spec["gpus"] == [{"count": "all"}]
    assert found["x11"].spec["volumes"] == ["/tmp/.X11-unix:/tmp/.X11-unix:ro"]
    whole = found["all"].spec
    assert {"gpus", "cap_add", "ulimits", "volumes", "ipc"} <= set(whole)
    assert (whole["environment"]["DISPLAY"], whole["environment"]["ROS_DOMAIN_ID"]) == (":1", "0")
    assert "privileged" not in whole


def test_a_service_leaves_out_what_its_profile_gives(tmp_path):
    service = {
        "profile": "ros1",
        "unset_environment": ["ROS_HOSTNAME"],
        "container": {"environment": {"ROS_IP": "10.0.0.2"}},
    }
    tree = write_tree(tmp_path, {"roscore": {}, "nav": service})
    environment = load_or_raise(tree).services["nav"].spec["environment"]
    assert "ROS_HOSTNAME" not in environment
    assert (environment["ROS_IP"], environment["ROS_MASTER_URI"]) == ("10.0.0.2", "http://localhost:11311")
    write_tree(tmp_path, {"roscore": {}, "nav": {**service, "unset_environment": ["ROS_HOSTNAM", "ROS_IP"]}})
    with pytest.raises(Invalid) as wrong:
        load_or_raise(tree)
    assert "no profile of it gives 'ROS_HOSTNAM'" in str(wrong.value)
    assert "'ROS_IP' is both set and unset" in str(wrong.value)


@pytest.mark.parametrize(
    ("devices", "rules", "volumes"),
    [
        (["/dev/input/by-id/joystick"], ["c 13:* rw"], ["/dev/input:/dev/input:ro"]),
        (["/dev/ttyUSB0:/dev/ttyUSB0:r"], ["c 188:* r"], ["/dev:/dev:ro"]),
        ([{"udev": {"vendor": "0403", "subsystem": "tty"}}], ["c 166:* rw", "c 188:* rw"], ["/dev:/dev:ro"]),
        (
            ["/dev/snd/a", "/dev/input/b"],
            ["c 116:* rw", "c 13:* rw"],
            ["/dev/snd:/dev/snd:ro", "/dev/input:/dev/input:ro"],
        ),
        (["/dev/video0", "/dev/input/b"], ["c 81:* rw", "c 13:* rw"], ["/dev:/dev:ro"]),
    ],
)
def test_hot_plugging_opens_a_class_of_devices_and_the_directory_of_its_nodes(devices, rules, volumes):
    assert rendered(devices=devices, hotplug=True) == {"device_cgroup_rules": rules, "volumes": volumes}


# -- real programs ---------------------------------------------------------------------------------------------

ZERO, NULL = os.makedev(1, 5), os.makedev(1, 3)


def put(path: Path, number: int) -> None:
    """A device node, in one step."""
    new = path.with_name("new")
    os.mknod(new, stat.S_IFCHR | 0o666, number)
    new.rename(path)


@pytest.mark.slow
@root_only
def test_on_real_engines_a_driver_follows_its_device(real_robot, tmp_path):
    robot, node = real_robot, tmp_path / "laser"
    robot.declare({"laser": {"always_on": True, "driver": {"devices": [f"{node}:/dev/laser"]}}})
    robot.wait(lambda: robot.waits("laser") == f"{node} is not there")
    assert robot.containers() == [] or robot.states() == {"laser": "created"}
    put(node, ZERO)
    robot.wait(lambda: robot.active() == {"laser"})
    robot.settle()
    first = robot.container("laser")
    assert number_inside(robot) in (ZERO, None)
    node.unlink()
    robot.wait(lambda: robot.states()["laser"] == "exited" and robot.waits("laser"))
    put(node, ZERO)
    robot.wait(lambda: robot.active() == {"laser"})
    assert robot.container("laser").id == first.id
    robot.settle()
    node.unlink()
    robot.wait(lambda: robot.states()["laser"] == "exited")
    put(node, NULL)
    robot.wait(lambda: robot.active() == {"laser"})
    robot.settle()
    assert [c.service for c in robot.containers()] == ["laser"]
    assert robot.container("laser").id != first.id
    told = [line for line in robot.log() if "laser: " in line]
    assert ["is not there" in line for line in told] == [True, False, True, False, True, False], told
    assert number_inside(robot) in (NULL, None)


def number_inside(robot) -> int | None:
    """Of the device as the driver sees it; None on an engine that gives it nothing of its own."""
    if robot.kind != "docker":
        return None
    program = "import os; print(os.stat('/dev/laser').st_rdev); os.close(os.open('/dev/laser', os.O_RDWR))"
    code, said = robot.engine.exec(robot.container("laser").id, ["python3", "-c", program], 20.0)
    assert code == 0, said
    return int(said)


def test_hot_plugging_on_docker(docker_robot):
    driver = {"devices": ["/dev/input/by-id/joystick"], "hotplug": True}
    tty = {"devices": [{"udev": {"vendor": "0403", "subsystem": "tty"}}], "hotplug": True}
    docker_robot.declare({"joy": {"always_on": True, "driver": driver}, "tty": {"always_on": True, "driver": tty}})
    docker_robot.wait(lambda: docker_robot.active() == {"joy", "tty"})
    look = "import os\ntry: os.open('/dev/kmsg', os.O_RDONLY)\nexcept OSError as error: print(error.errno)"
    code, said = docker_robot.engine.exec(docker_robot.container("tty").id, ["python3", "-c", look], 20.0)
    assert (code, int(said)) == (0, errno.EPERM), "what is seen may not be used, but for its class"


def test_validate_looks_for_devices_that_are_known_by_what_they_say(tmp_path):
    driver = {"devices": [{"udev": {"vendor": "0403"}, "target": "/dev/arm"}]}
    found = load(write_tree(tmp_path, {"arm": {"driver": driver}}))
    (device,) = found.catalog.services["arm"].devices
    told = [check_machine(found.catalog, found.sources, Facts(plugged={device: p})) for p in (GONE, THERE)]
    assert [[(d.code, d.message) for d in said] for said in told] == [
        [("missing-device", "a device with vendor 0403 is not there")],
        [],
    ]


def test_a_service_of_the_last_good_tree_is_read_back_whole(tmp_path):
    laser = Device("udev(vendor=1):/dev/laser", udev=(("vendor", "1"),))
    ready = Probe("several", 1.0, parts=(Probe("tcp", "localhost:1"), Probe("exec", ("a", "b"))))
    driver = Service("driver", devices=(laser,), ready=ready, idle=Idle(escalate=(3.0, "stop")), spec={"image": "a:1"})
    kept = Kept(Catalog({"driver": driver}, {"all": Group("all", ("driver",))}), {"driver": Former(driver, ("other",))})
    write_kept(tmp_path, kept)
    found = read_kept(tmp_path)
    assert (found.catalog.services, found.catalog.groups) == (kept.catalog.services, kept.catalog.groups)
    assert found.former == kept.former


def test_true_is_a_driver_without_devices_and_false_is_none(tmp_path):
    write_tree(tmp_path, {"arm": {"driver": True}, "wheels": {"driver": {}}, "camera": {"driver": False}})
    services = load_or_raise(tmp_path).services
    assert (services["arm"].driver, services["wheels"].driver, services["camera"].driver) == (True, True, False)
