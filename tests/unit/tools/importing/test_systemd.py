"""Units of systemd and launch files as manifests: `rorg import systemd`, `rorg import roslaunch`."""

from __future__ import annotations

from pathlib import Path

import pytest

from rorg.manifest.load import load
from rorg.manifest.yaml_text import plain
from rorg.tools.importing.roslaunch import from_roslaunch
from rorg.tools.importing.systemd import from_systemd

NAV = """\
[Unit]
Description=Navigation
After=network-online.target
Wants=network-online.target
Requires=lidar.service

[Service]
# a comment
ExecStart=/opt/nav/run --map "my map" \\
  --fast
Environment=A=1 "B=two words"
Environment=C=3
Restart=always
RestartSec=2
User=robot
Group=dialout
KillSignal=SIGINT
TimeoutStopSec=1min 5s
LimitRTPRIO=99
LimitNOFILE=1024:65536
MemoryMax=500M
CPUQuota=150%
WatchdogSec=10

[Install]
WantedBy=multi-user.target
"""
LIDAR = "[Service]\nExecStartPre=/bin/sleep 1\nExecStart=-/opt/lidar $DEVICE\nRestart=on-failure\n"
TARGET = "[Unit]\nDescription=All of it\nWants=nav.service lidar.service other.service\n"


def units(**texts: str) -> dict[Path, str]:
    return {Path(name.replace("_", ".")): text for name, text in texts.items()}


def specs(imported) -> dict[str, dict]:
    return {made.name: plain(made.spec) for made in imported.manifests}


def write(imported, tree: Path) -> Path:
    for name, text in imported.texts.items():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        (tree / name).write_text(text)
    return tree


def test_a_unit_is_a_service_that_says_the_same(tmp_path):
    imported = from_systemd(units(nav_service=NAV, lidar_service=LIDAR, robot_target=TARGET), "", tmp_path)
    found = specs(imported)
    assert found["nav"] == {
        "image": "host",
        "command": ["/opt/nav/run", "--map", "my map", "--fast"],
        "needs": ["lidar"],
        "always_on": True,
        "restart": "always",
        "container": {
            "environment": {"A": "1", "B": "two words", "C": "3"},
            "user": "robot:dialout",
            "stop_signal": "SIGINT",
            "stop_grace_period": "65s",
            "ulimits": {"rtprio": 99, "nofile": {"soft": 1024, "hard": 65536}},
            "mem_limit": "500Mi",
            "cpus": 1.5,
        },
    }
    assert found["lidar"]["command"] == ["sh", "-c", "/bin/sleep 1 && exec /opt/lidar $DEVICE"]
    assert found["lidar"]["restart"] == "on-failure"
    assert found["robot"] == {"services": ["nav", "lidar"]}
    told = [str(d) for d in imported.diagnostics]
    assert told == [
        "lidar.service:3:1: note: ExecStart=-: for systemd, a failure of this program counts as success; rorg sees the "
        "failure",
        "nav.service:4:1: note: network-online.target: not imported, so not in needs",
        "nav.service:14:1: note: RestartSec is not carried over; leave it out: delays grow automatically",
        "nav.service:23:1: note: WatchdogSec is not carried over; try a `live` probe",
    ]
    assert "# WatchdogSec is not carried over" in imported.texts["services/nav.yaml"]
    assert not load(write(imported, tmp_path)).errors


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[Service]\nType=forking\nExecStart=/x\n", "x.service:2:1: error: Type=forking"),
        ("[Service]\nExecStart=/x %i\n", "x.service:2:1: error: specifiers such as %i"),
        ("[Service]\nExecStart=/x 'a\n", "x.service:2:1: error: not a command line"),
        ("[Unit]\nDescription=x\n", "x.service:1:1: error: x starts nothing"),
    ],
)
def test_what_a_unit_cannot_be_carried_over_for(text, message, tmp_path):
    imported = from_systemd(units(x_service=text), "", tmp_path)
    assert str(imported.errors[0]).startswith(message)


def test_a_socket_is_no_service(tmp_path):
    imported = from_systemd({Path("x.socket"): "[Socket]\nListenStream=80\n"}, "", tmp_path)
    assert "x.socket is neither a service nor a target" in str(imported.errors[0])


LAUNCH = """\
<launch>
  <arg name="map"/>
  <arg name="sim" default="false"/>
  <group ns="robot"><node pkg="a" type="b" name="lidar"/></group>
  <node pkg="move_base" type="move_base" name="move_base" required="true"/>
  <node if="$(arg sim)" pkg="a" type="b" name="gazebo"/>
  <node unless="$(arg sim)" pkg="a" type="b" name="base"/>
  <include file="$(find mypkg)/launch/inc.launch" ns="front"><arg name="x" value="1"/></include>
  <include file="$(find other)/launch/far.launch"/>
</launch>
"""
FILES = {
    "/ws/mypkg/package.xml": "<package><name>mypkg</name><buildtool_depend>catkin</buildtool_depend></package>",
    "/ws/mypkg/launch/nav.launch": LAUNCH,
    "/ws/mypkg/launch/inc.launch": '<launch><arg name="x"/><node pkg="q" type="q" name="cam$(arg x)"/></launch>',
    "/ws/mypkg/launch/ring.launch": '<launch><include file="$(dirname)/ring.launch"/></launch>',
}


def read(path: Path) -> str:
    if str(path) in FILES:
        return FILES[str(path)]
    raise FileNotFoundError(2, "No such file or directory", str(path))


def launched(name: str, arguments: dict[str, str], **options):
    return from_roslaunch(Path("/ws/mypkg/launch") / name, read, arguments, **options)


def test_a_launch_file_is_a_service_with_its_required_node_as_readiness(tmp_path):
    imported = launched("nav.launch", {"map": "/m"})
    assert specs(imported)["nav"] == {
        "image": "ros:noetic-ros-base",
        "command": ["roslaunch", "--wait", "mypkg", "nav.launch", "map:=/m"],
        "profile": "ros1",
        "ready": {"ros_node": "/move_base", "timeout": "60s"},
    }
    text = imported.texts["services/nav.yaml"]
    assert "# Its nodes: /robot/lidar, /move_base, /base, /front/cam1." in text
    assert "is in another package" in text
    assert not load(write(imported, tmp_path)).errors
    assert "roscore" in specs(imported)
    assert "roscore" not in specs(launched("nav.launch", {"map": "/m"}, with_master=False))
    assert specs(launched("nav.launch", {"map": "/m"}, image="lab/nav"))["nav"]["image"] == "lab/nav"


def test_arguments_that_are_missing_rings_and_broken_files_are_told():
    assert "the argument map has no value; try map:=VALUE" in str(launched("nav.launch", {}).errors[0])
    assert any("include each other" in d.message for d in launched("ring.launch", {}).diagnostics)
    assert launched("nosuch.launch", {}).errors
    FILES["/ws/mypkg/launch/bad.launch"] = "<launch>\n<node></launch>"
    assert "bad.launch:2:" in str(launched("bad.launch", {}).errors[0])
