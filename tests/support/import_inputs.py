"""Projects to import that are mutated, and what must hold of the result."""

from __future__ import annotations

import shutil
from pathlib import Path

from rorg.manifest.documents import UNEXPECTED
from rorg.manifest.load import load
from rorg.tools.importing.manifests import Imported
from rorg.tools.importing.manifests import write_tree as write_imported

LAUNCH = """\
<?xml version="1.0"?>
<launch>
  <arg name="map" default="lab"/>
  <arg name="sim" default="false"/>
  <arg name="where" value="$(find robot)/maps/$(arg map)"/>
  <group ns="robot" unless="$(arg sim)">
    <node pkg="a" type="b" name="lidar" required="true"/>
    <group ns="$(arg map)"><node pkg="a" type="b" name="$(arg map)_node" if="$(arg sim)"/></group>
  </group>
  <include file="$(dirname)/inner.launch" ns="front" pass_all_args="true"><arg name="x" value="$(arg where)"/></include>
  <include file="$(find other)/launch/far.launch"/>
  <machine name="m" address="a"/>
</launch>
"""

LAUNCHES = {
    "nav.launch": LAUNCH,
    "inner.launch": '<launch>\n  <arg name="x"/>\n  <node pkg="q" type="q" name="cam$(arg x)"/>\n</launch>\n',
    "package.xml": "<package>\n  <name>robot</name>\n</package>\n",
}

LAUNCH_WORDS = (
    '<include file="$(dirname)/nav.launch"/>', '<include file="$(dirname)/inner.launch" pass_all_args="1"/>',
    "<group>", "</group>", '<group ns="a">', '<arg name="map" value="$(arg map)$(arg map)"/>', "$(arg map)",
    "$(arg ", "$(find robot)", "$(eval 1)", "$(dirname)", '<include file="/dev/zero"/>',
    '<include file="/etc/shadow"/>', "<!DOCTYPE a [", "<![CDATA[", '<!DOCTYPE a [<!ENTITY b "c">]>', "&b;", "&#0;",
    "&#x10ffff;", '<node name="n" pkg="p" type="t"/>', "<!--", "-->", "<launch>",
)  # fmt: skip

LAUNCHES2 = {
    "nav.launch.xml": """\
<launch>
  <arg name="map"/>
  <arg name="ns" default="$(env NS a)"/>
  <let name="both" value="$(var map)/$(var ns)"/>
  <group>
    <push_ros_namespace namespace="$(var ns)"/>
    <set_parameter name="use_sim_time" value="true"/>
    <node pkg="p" exec="e" name="n" args="--a '$(var both)'" if="$(eval &quot;'$(var ns)' == 'a'&quot;)">
      <param name="x"><param name="y" value="[1, 2]"/></param>
      <param from="$(find-pkg-share robot)/x.yaml"/>
      <remap from="a" to="b"/>
    </node>
    <node_container pkg="p" exec="e" name="c" namespace="">
      <composable_node pkg="p" plugin="p::C" name="d"/>
    </node_container>
  </group>
  <include file="$(dirname)/inner.launch.yaml"/>
</launch>
""",
    "inner.launch.yaml": """\
launch:
- arg: {name: x, default: '1'}
- set_env: {name: A, value: $(dirname)/b}
- node:
    pkg: q
    exec: e
    param:
    - {name: a, value: [1.5, 2]}
    - {from: $(dirname)/y.yaml, allow_substs: true}
- load_composable_node:
    target: a/c
    composable_node:
    - {pkg: q, plugin: 'q::D'}
- executable: {cmd: 'echo $(var x)', shell: true}
""",
    "package.xml": "<package>\n  <name>robot</name>\n  <buildtool_depend>ament_cmake</buildtool_depend>\n</package>\n",
}

LAUNCH2_WORDS = (
    '<include file="$(dirname)/nav.launch.xml"/>', "<group>", "</group>",
    '<let name="map" value="$(var map)$(var map)"/>',
    "- include: {file: $(dirname)/inner.launch.yaml}", "- group: &a [group: *a]",
    "  - let: {name: x, value: $(var x)$(var x)}",
    "$(var x)", "$(eval '1 + 1')", "$(eval '", "$(command id)", "$(not $(var x))", "$(find-pkg-share robot)",
    "$(find-exec a)", "!!python/name:os.system x", "<<: *a", "\\$(", "\ue0000\ue001", "value: .nan",
    "- timer: {period: 1, children: []}",
    '<node pkg="p" exec="e"/>', '<lifecycle_node pkg="p" exec="e" name="l" autostart="true"/>',
    "&#10;", "type: list_of_str",
)  # fmt: skip

UNIT = """\
[Unit]
Description=Navigation
After=network-online.target
Requires=lidar.service
Conflicts=arm.service
[Service]
Type=simple
ExecStartPre=-/bin/sleep 1
ExecStart=/opt/nav/run --map "my map" \\
  --fast $ARGS
Environment=A=1 "B=two words"
EnvironmentFile=-/etc/nav.env
Restart=on-failure
RestartSec=2
User=robot
Group=dialout
KillSignal=SIGINT
TimeoutStopSec=1min 5s
LimitRTPRIO=99
LimitNOFILE=1024:65536
MemoryMax=500M
CPUQuota=150%
TasksMax=100
WorkingDirectory=~
[Install]
WantedBy=multi-user.target
"""

UNITS = {
    "nav.service": UNIT,
    "lidar.service": "[Service]\nExecStart=/opt/lidar 'a b' %i\n",
    "robot.target": "[Unit]\nDescription=All\nWants=nav.service lidar.service\n",
}

UNIT_WORDS = (
    "\\", '"', "'", "%i", "%%", "$A", "infinity", "TimeoutStopSec=.s", "TimeoutSec=1.2.3", "CPUQuota=..%",
    "TasksMax=²", "LimitNOFILE=1:2:3", "Environment=", 'Environment="A=b', "ExecStart=", "Type=forking",
    "Type=notify", "MemoryMax=9K", '9' * 30, "1e9", "-1", "#", ";", "[", 'a' * 3000, "nav.service",
    "Wants=robot.target", "TimeoutStopSec=1us 2h",
)  # fmt: skip

COMPOSE = """\
name: bot
include:
  - parts/compose.yaml
  - {path: other.yaml, env_file: nav.env}
x-common: &common
  restart: unless-stopped
  logging: {driver: json-file, options: {max-size: 1m}}
services:
  nav:
    <<: *common
    image: lab/nav:${TAG:-1}
    command: ["run", "--map", "$$HOME/${MAP:-lab}"]
    environment: {ROS_DOMAIN_ID: , MODE: fast}
    env_file: [nav.env, {path: none.env, required: false}]
    extends: {file: common.yaml, service: base}
    depends_on:
      db: {condition: service_healthy, restart: true}
    ports: ["8080:80", "127.0.0.1:9000-9001:9000-9001/udp"]
    volumes: ["./maps:/maps:ro", "data:/data"]
    devices: ["/dev/video0:/dev/camera:r"]
    ulimits: {nofile: {soft: 1, hard: 2}}
    configs: [{source: settings, target: /etc/s, mode: 0440}]
    secrets: [token]
    profiles: [tools]
    deploy:
      replicas: 2
      resources:
        limits: {cpus: "1.5", memory: 512M, pids: 100}
        reservations: {cpus: "0.5", devices: [{driver: nvidia, count: all, capabilities: [gpu]}]}
  db:
    build: {context: ., dockerfile_inline: "FROM x", args: [A=b], additional_contexts: {c: ./parts}}
    healthcheck: {test: pg_isready, interval: 2s, timeout: 1s, retries: 5, start_period: 30s}
    network_mode: host
volumes: {data: {}}
networks: {default: {ipam: {config: [{subnet: 10.0.0.0/24}]}}}
configs: {settings: {content: "a: ${MAP}"}}
secrets: {token: {environment: HOME}}
"""

PROJECT = {
    "compose.yaml": COMPOSE,
    "common.yaml": "services:\n  base: {image: x, extends: above, init: true}\n  above: {environment: {A: b}}\n",
    "parts/compose.yaml": "services:\n  part: {image: part, volumes: ['./d:/d']}\n",
    "other.yaml": "services:\n  other: {image: other, environment: [NAV]}\n",
    ".env": "MAP=hall\nTAG=2\nLONG=${MAP}${TAG}\n",
    "nav.env": "NAV=1\nBARE\nQUOTED='a b'\n",
}

PROJECT_WORDS = (
    "- compose.yaml", "- ../outside", "!reset []", "!override", "<<: *common", "*common", "&common", "${MAP",
    "${MAP:?no}", "extends: nav", "extends: {file: compose.yaml, service: nav}", "env_file: /dev/zero",
    "env_file: nav.env", "scale: 9999999", 'ports: ["1-65535:1-65535"]', '"1-9000"', "x-a: [[[[", "---", "null",
    "0x10", "1e400", "MAP=${MAP}${MAP}", "services:", "  s: {image: x}", '"../../a": {content: b}', "[", "{",
    "a: &a [*a]", "!!binary x", "- {path: [a, b]}", "-1", "1h99d",
)  # fmt: skip


def is_whole(imported: Imported, folder: Path, number: int) -> None:
    """It can be written, and what is written is read or refused in words; some of it is tried."""
    assert imported.manifests or imported.errors
    if imported.errors:
        return
    texts = imported.texts
    if number % 4 or sum(map(len, texts.values())) > 1 << 18:
        return
    tree = folder / "manifests"
    write_imported(imported, tree)
    try:
        unexpected = [str(d) for d in load(tree).errors if UNEXPECTED in d.message]
    finally:
        shutil.rmtree(tree)
    assert not unexpected, unexpected
