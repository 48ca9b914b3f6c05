"""Imports that end with exit code 0 pass `rorg validate`, and lose nothing without a word."""

from __future__ import annotations

import pytest
from compose_imports import imported, spec, told, write
from incomplete_projects import UNSUPPORTED, of_units

from rorg.manifest.load import load
from rorg.manifest.yaml_text import plain
from rorg.tools.compose import load as read_project
from rorg.tools.importing.compose import from_compose

HEAD = "name: bot\nservices:\n  nav:\n    image: lab/nav\n    network_mode: host\n    "

UNSET = {
    "user: '${WHO}:${GROUP}'": {},
    "user: '1000:${GROUP}'": {"user": "1000"},
    "user: '${WHO}:20'": {"user": "0:20"},
    "hostname: ${ROBOT}\n    domainname: ''": {},
    "runtime: ${RUNTIME}\n    cpuset: ''\n    working_dir: ''\n    stop_signal: ''\n    mac_address: ''": {},
    "container_name: ${NAME}\n    restart: ''\n    platform: ''\n    ipc: ''\n    pid: ''\n    userns_mode: ''": {},
    "logging: {driver: json-file, options: {max-size: , max-file: 3}}": {
        "logging": {"driver": "json-file", "options": {"max-file": "3"}}
    },
    "ulimits: {nice: -20, rtprio: 99}": {"ulimits": {"nice": -1, "rtprio": 99}},
    "mem_limit: 1Gi\n    shm_size: 1.5GiB": {"mem_limit": "1Gi", "shm_size": "1536Mi"},
    "devices: ['/dev/null:rw', '/dev/dri']": {"devices": ["/dev/null:/dev/null:rw", "/dev/dri"]},
    "devices: ['nvidia.com/gpu=all']": {"gpus": [{"driver": "cdi", "device_ids": ["nvidia.com/gpu=all"]}]},
    "environment: {A: 1e6, B: 1.5e6, C: 1e5, D: 0.0001, E: 2.0, F: 123456789.5, G: 1e-5}": {
        "environment": {
            **{"A": "1e+06", "B": "1.5e+06", "C": "100000", "D": "0.0001", "E": "2"},
            **{"F": "1.234567895e+08", "G": "1e-05"},
        }
    },
    "gpus: all\n    deploy: {resources: {reservations: {devices: [{driver: nvidia, capabilities: [gpu]}]}}}": {
        "gpus": [{"count": "all"}, {"driver": "nvidia", "capabilities": ["gpu"]}]
    },
}


@pytest.mark.parametrize("said", UNSET)
def test_what_compose_takes_is_valid(said, tmp_path):
    found = imported(tmp_path, f"{HEAD}{said}\n")
    expected = {"container_name": "bot-nav-1", "network_mode": "host", **UNSET[said]}
    assert spec(found)["container"] == expected
    assert not load(write(found, tmp_path / "manifests")).errors


def test_an_empty_network_mode_is_the_default_network(tmp_path):
    found = imported(tmp_path, "name: bot\nservices:\n  nav: {image: a, network_mode: '${MODE}'}\n")
    assert spec(found)["container"]["networks"] == {"default": {"aliases": ["nav"]}}


def test_an_image_whose_context_is_missing_is_not_built(tmp_path):
    (tmp_path / "empty").mkdir()
    text = "name: bot\nservices:\n  nav: {image: lab/nav, build: ./gone}\n  arm: {image: lab/arm, build: empty}\n"
    found = imported(tmp_path, text)
    assert [m.name for m in found.manifests if m.kind == "Image"] == []
    assert [line.partition(":")[0] for line in told(found)] == ["3", "4"]
    assert all("so nothing builds lab/" in line and ": warning: " in line for line in told(found))
    assert "nothing builds lab/nav" in found.texts["services/nav.yaml"]
    assert not load(write(found, tmp_path / "manifests")).errors
    refused = imported(tmp_path, "name: bot\nservices:\n  nav: {build: ./gone}\n")
    assert "is missing, and nav names no image" in str(refused.errors[0])


def test_alternatives_with_one_container_name_conflict(tmp_path):
    text = (
        "name: bot\nservices:\n  real: {image: a, container_name: nav, profiles: [real]}\n"
        "  sim: {image: b, container_name: nav, profiles: [sim]}\n"
    )
    found = imported(tmp_path, text)
    assert spec(found, "real")["container"]["container_name"] == "nav"
    assert spec(found, "sim")["container"]["container_name"] == "bot-sim-1"
    assert spec(found, "sim")["conflicts"] == ["real"]
    assert any("real has the container_name nav, too" in line for line in told(found))
    assert not load(write(found, tmp_path / "manifests")).errors


def test_a_secret_takes_its_value_from_the_env_file_of_the_project(tmp_path):
    (tmp_path / ".env").write_text("KEY=of the file\n")
    found = imported(
        tmp_path,
        "name: bot\nservices:\n  nav: {image: a, secrets: [key]}\nsecrets: {key: {environment: KEY}}\n",
        env_files=[tmp_path / ".env"],
    )
    assert found.files == {"secrets/key": "of the file"}


def test_nothing_is_lost_without_a_note(tmp_path):
    (tmp_path / "Dockerfile").write_text("FROM busybox\n")
    text = (
        "name: bot\nservices:\n  nav:\n    build: {context: ., network: host}\n    devices: [/dev/lidar, /dev/dri]\n"
        "    volumes: [{type: volume, source: v, target: /v, consistency: cached}]\n"
        "volumes: {v: {}}\nmodels: {llm: {model: ai/small}}\n"
    )
    found = imported(tmp_path, text)
    lines = "\n".join(told(found))
    assert "build.network is not carried over" in found.texts["images/bot-nav.yaml"]
    assert "consistency has no effect on a named volume" in lines
    assert "models.llm is not carried over" in lines
    note = next(d for d in found.diagnostics if "/dev/lidar" in d.message)
    assert note.remedy == "driver: {devices: [/dev/lidar, /dev/dri]} instead of container.devices"
    assert "/dev/dri to be" not in lines


def test_files_of_labels_are_files_of_the_project(tmp_path):
    (tmp_path / "l.env").write_text("a=b\n")
    (tmp_path / "compose.yaml").write_text("services:\n  nav: {image: a, label_file: l.env}\n")
    project = read_project([tmp_path / "compose.yaml"], {}).project
    assert project is not None
    assert tmp_path / "l.env" in project.files


UNIT = """\
[Service]
ExecStartPre=-/bin/rm -f /tmp/lock
ExecStartPre=+/sbin/modprobe can
ExecStart=/opt/cam --name %i --dev /dev/%I --state %S/cam
User=robot
SupplementaryGroups=video dialout
CPUAffinity=0 2-3
Environment=CAMERA=%i RATE=5%%
"""


def test_a_unit_keeps_its_groups_cpus_and_failures_that_do_not_matter(tmp_path):
    found = of_units(**{"cam__usb-front": UNIT})
    assert plain(found.manifests[0].spec) == {
        "image": "host",
        "command": [
            *("sh", "-c"),
            "{ /bin/rm -f /tmp/lock || true; } && /sbin/modprobe can && "
            "exec /opt/cam --name usb-front --dev /dev/usb/front --state /var/lib/cam",
        ],
        "restart": "never",
        "container": {
            "user": "robot",
            "group_add": ["video", "dialout"],
            "cpuset": "0,2-3",
            "environment": {"CAMERA": "usb-front", "RATE": "5%"},
        },
    }
    assert found.manifests[0].name == "cam-usb-front"
    assert [d.message for d in found.diagnostics] == [
        "ExecStartPre=+: systemd runs this command as root; here, robot runs it"
    ]
    assert not load(write(found, tmp_path)).errors


def test_a_template_is_imported_for_each_instance_that_is_named(tmp_path):
    robot = "[Unit]\nRequires=cam@front.service cam@rear.service\n[Service]\nExecStart=/opt/robot\n"
    found = of_units(cam__=UNIT, robot=robot)
    assert [made.name for made in found.manifests] == ["cam-front", "cam-rear", "robot"]
    assert plain(found.manifests[2].spec)["needs"] == ["cam-front", "cam-rear"]
    assert not load(write(found, tmp_path)).errors
    alone = of_units(cam__=UNIT)
    assert "cam@.service is a template, and no instance of it is named" in str(alone.errors[0])
    default = of_units(cam__=UNIT + "[Install]\nDefaultInstance=top\n")
    assert [made.name for made in default.manifests] == ["cam-top"]


def test_skipped_services_are_not_needed_and_builds_say_which_image(tmp_path):
    (tmp_path / "compose.yaml").write_text(UNSUPPORTED)
    loaded = read_project([tmp_path / "compose.yaml"], {})
    assert loaded.project
    found = from_compose(loaded.project, tmp_path / "manifests", tmp_path, lambda _: None, skip=True)
    assert "needs" not in spec(found)
    assert spec(found, "far")["image"] == "lab/far"
