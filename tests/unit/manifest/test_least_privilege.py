"""The tour-guide robot's services get no more of the machine than they declare, and say where each value comes from."""

from __future__ import annotations

import shutil

import pytest
from common import ROOT

from rorg.manifest.load import load_or_raise

ONCE_PRIVILEGED = (
    "freight_base",
    "back_laser",
    "head_laser",
    "teleop",
    "usb_cam",
    "head_laser_servo",
    "psutil_stats_logger",
    "ros_speak_text",
    "microphone",
)
"""Services of the robot's own source that are privileged there."""
CAPABILITIES = {"freight_base": ["SYS_NICE"]}
"""Of these: a control loop needs its priority."""


@pytest.fixture(scope="module")
def with_hardware(tmp_path_factory):
    """The robot as it is where its devices are: without the stand-ins, which get none."""
    root = tmp_path_factory.mktemp("robot")
    for folder in ("manifests", "images"):
        shutil.copytree(ROOT / folder, root / folder)
    profile = root / "manifests/profiles/standin.yaml"
    text = profile.read_text()
    assert "without_hardware: true" in text
    profile.write_text(text.replace("without_hardware: true", "without_hardware: false"))
    return load_or_raise(root / "manifests").services


def test_there_are_nine():
    assert len(set(ONCE_PRIVILEGED)) == 9


@pytest.mark.parametrize("name", ONCE_PRIVILEGED)
def test_what_was_privileged_gets_its_devices_and_no_more(with_hardware, name):
    service = with_hardware[name]
    spec = service.spec
    assert not spec.get("privileged")
    assert spec.get("cap_add", []) == CAPABILITIES.get(name, [])
    assert "no-new-privileges:true" in spec["security_opt"]
    assert not any("unconfined" in option for option in spec["security_opt"])
    assert sorted(spec.get("devices", [])) == sorted(device.text for device in service.devices)
    assert all(device.path.startswith("/dev/") and device.path.strip("/") != "dev" for device in service.devices)
    assert not spec.get("device_cgroup_rules")
    sources = [str(volume).partition(":")[0] + "/" for volume in spec.get("volumes", [])]
    assert not [s for s in sources if s == "/" or s.startswith(("/dev/", "/sys/", "/proc/", "/run/", "/var/run/"))]
    without = ("freight_base", "psutil_stats_logger")  # one talks to a network, one reads /proc
    assert bool(service.devices) == (name not in without)
