"""`rorg import compose`: what each part of a Compose file becomes, and what is said of the rest."""

from __future__ import annotations

import shutil
import time

import pytest
from common import ROOT
from compose_cases import CASES, load_from
from compose_imports import imported, spec, text_of, told, write

from rorg.manifest.load import load
from rorg.tools.importing import compose_keys
from rorg.tools.importing.compose import from_compose

REFUSED = {"every_key": 5}
"""Cases of which something cannot be carried over, with how many things."""
WRONG = {"extends_everything"}
"""Cases whose values no engine takes."""
NAMES = sorted({path.parent.name for path in CASES.glob("*/config.json")} - WRONG)


TABLES = {
    "service": compose_keys.SERVICE,
    "build": compose_keys.BUILD,
    "deploy": compose_keys.DEPLOY,
    "limits": compose_keys.LIMIT,
    "reservations": compose_keys.RESERVATION,
    "healthcheck": compose_keys.HEALTHCHECK,
    "service network": compose_keys.SERVICE_NETWORK,
    "network": compose_keys.NETWORK,
    "volume": compose_keys.VOLUME,
    "config or secret": compose_keys.FILE,
    "config or secret of a service": compose_keys.SERVICE_FILE,
}


def test_every_key_of_compose_has_a_row():
    known: dict[str, set[str]] = {}
    for line in (ROOT / "tests/cases/import/compose_keys.txt").read_text().splitlines()[1:]:
        section, _, keys = line.partition(":")
        known.setdefault(section, set()).update(keys.split())
    assert {name: set(rows) for name, rows in TABLES.items()} == known
    for rows in TABLES.values():
        for key, row in rows.items():
            assert row.why or row.how in ("carried", "consumed"), key
            assert row.remedy or row.how != "refused", key


def test_the_keys_that_are_carried_are_options_of_a_container():
    from rorg.manifest.container import ContainerOptions

    assert {k for k, row in TABLES["service"].items() if row.how == "carried"} <= set(ContainerOptions.model_fields)


WHOLE = """\
name: bot
services:
  nav:
    image: lab/nav:1
    command: ["run", "--map", "$$HOME/${MAP:-lab}"]
    restart: unless-stopped
    environment: {ROS_DOMAIN_ID: , MODE: fast}
    env_file: [nav.env]
    depends_on:
      db: {condition: service_healthy, restart: true}
      migrate: {condition: service_completed_successfully}
    ports: ["8080:80", "127.0.0.1:9000-9001:9000-9001/udp"]
    volumes: ["./maps:/maps:ro", "data:/data"]
    devices: ["/dev/video0:/dev/camera:r"]
    deploy:
      resources:
        limits: {cpus: "1.5", memory: 512M, pids: 100}
        reservations: {cpus: "0.5", memory: 100M, devices: [{driver: nvidia, count: all, capabilities: [gpu]}]}
  db:
    image: lab/db
    healthcheck: {test: pg_isready, interval: 2s, timeout: 1s, retries: 5, start_period: 30s}
  migrate:
    image: lab/db
    restart: on-failure:3
volumes: {data: {}}
"""


def test_a_project_becomes_services_that_say_the_same(tmp_path):
    (tmp_path / "nav.env").write_text("# of the lab\nKEY='a b'\n")
    found = imported(tmp_path, WHOLE, {"ROS_DOMAIN_ID": "7"})
    assert spec(found) == {
        "image": "lab/nav:1",
        "command": ["run", "--map", "$HOME/lab"],
        "needs": [{"service": "db", "restart": True}, "migrate"],
        "restart": "always",
        "resources": {"cpu": 0.5, "memory": "100Mi"},
        "container": {
            "container_name": "bot-nav-1",
            "env_file": ["../../nav.env"],
            "environment": {"ROS_DOMAIN_ID": "7", "MODE": "fast"},
            "devices": ["/dev/video0:/dev/camera:r"],
            "networks": {"default": {"aliases": ["nav"]}},
            "ports": ["8080:80", "127.0.0.1:9000:9000/udp", "127.0.0.1:9001:9001/udp"],
            "volumes": ["../../maps:/maps:ro", "data:/data"],
            "cpus": 1.5,
            "mem_limit": "512Mi",
            "pids_limit": 100,
            "mem_reservation": "100Mi",
            "gpus": [{"driver": "nvidia", "count": "all", "capabilities": ["gpu"]}],
        },
    }
    assert spec(found, "db")["ready"] == {"engine": "healthy", "timeout": "60s"}
    assert spec(found, "db")["restart"] == "never"
    assert spec(found, "migrate")["restart"] == "on-failure"
    assert spec(found, "migrate")["ready"] == {"completed": True}
    assert spec(found, "default", "Network") == {"name": "bot_default"}
    assert spec(found, "data", "Volume") == {"name": "bot_data"}
    assert spec(found, "compose", "Request")["services"] == ["nav", "db", "migrate"]
    assert told(found) == [
        "7:19: note: ROS_DOMAIN_ID was taken from the environment: its current value is now fixed in nav",
        "14:5: note: rorg waits for /dev/video0 to be plugged in only if `driver` names it",
        "24:5: note: restart: on-failure:3: rorg restarts without limit, with growing delays",
    ]
    assert "# From compose.yaml:3:3, service nav." in found.texts["services/nav.yaml"]
    assert not load(write(found, tmp_path / "manifests")).errors


CARRIED = {
    "volumes: [{type: bind, source: /a, target: /b, bind: {propagation: rslave}}]": {
        "volumes": [{"type": "bind", "source": "/a", "target": "/b", "bind": {"propagation": "rslave"}}]
    },
    "volumes: [/anonymous, {type: tmpfs, target: /t, tmpfs: {size: 10m, mode: 0o1777}}]": {
        "volumes": ["/anonymous", {"type": "tmpfs", "target": "/t", "tmpfs": {"size": "10Mi", "mode": 0o1777}}]
    },
    "extra_hosts: {base: 10.0.0.1, gate: [1.1.1.1, 2.2.2.2]}": {
        "extra_hosts": ["base:10.0.0.1", "gate:1.1.1.1", "gate:2.2.2.2"]
    },
    "shm_size: 1gb": {"shm_size": "1Gi"},
    "mem_limit: 10000001": {"mem_limit": 10000001},
    "stop_grace_period: 1m30s": {"stop_grace_period": "90s"},
    "healthcheck: {disable: true}": {"healthcheck": {"disable": True}},
    "ulimits: {nofile: 1024, core: {soft: 0, hard: 1}}": {"ulimits": {"nofile": 1024, "core": {"soft": 0, "hard": 1}}},
    "init: true\n    privileged: true": {"init": True, "privileged": True},
    "group_add: [video, 100]": {"group_add": ["video", "100"]},
    "environment: [A=1, 'B=x=y', C=]": {"environment": {"A": "1", "B": "x=y", "C": ""}},
    "labels: {a: true, b: 1}": {"labels": {"a": "true", "b": "1"}},
    "logging: {driver: local, options: {max-size: 10m}}": {
        "logging": {"driver": "local", "options": {"max-size": "10m"}}
    },
    "security_opt: ['seccomp:./s.json', 'no-new-privileges:true']": {
        "security_opt": ["seccomp=../../s.json", "no-new-privileges:true"]
    },
    "blkio_config: {weight: 300, device_read_bps: [{path: /dev/sda, rate: 12mb}]}": {
        "blkio_config": {"weight": 300, "device_read_bps": [{"path": "/dev/sda", "rate": "12Mi"}]}
    },
    "sysctls: [kernel.shmmax=1]": {"sysctls": {"kernel.shmmax": "1"}},
    "tmpfs: /tmp": {"tmpfs": ["/tmp"]},
    "entrypoint: /e.sh a": {"entrypoint": ["/e.sh", "a"]},
    "dns: 1.1.1.1": {"dns": ["1.1.1.1"]},
}


@pytest.mark.parametrize("said", CARRIED)
def test_an_option_is_carried_over(said, tmp_path):
    (tmp_path / "s.json").write_text("{}")
    found = imported(tmp_path, f"name: bot\nservices:\n  nav:\n    image: a\n    network_mode: host\n    {said}\n")
    container = spec(found)["container"]
    assert not found.diagnostics
    assert container == {"container_name": "bot-nav-1", "network_mode": "host", **CARRIED[said]}
    assert not load(write(found, tmp_path / "manifests")).errors


def test_parts_of_containers_of_others_are_named_as_services(tmp_path):
    found = imported(
        tmp_path,
        "name: bot\nservices:\n  nav: {image: a, network_mode: 'service:vpn', ipc: 'service:vpn', "
        "volumes_from: [vpn:ro]}\n"
        "  vpn: {image: v}\n  web: {image: w, links: ['vpn:gate'], networks: [host]}\n"
        "networks: {host: {external: true, name: host}}\n",
    )
    assert spec(found)["container"] == {
        "container_name": "bot-nav-1",
        "ipc": "service:vpn",
        "network_mode": "service:vpn",
        "volumes_from": ["vpn:ro"],
    }
    assert spec(found, "vpn")["container"]["networks"] == {"default": {"aliases": ["vpn", "gate"]}}
    assert spec(found, "web")["needs"] == ["vpn"]
    assert spec(found, "web")["container"]["network_mode"] == "host"
    assert "Network/host" not in {f"{m.kind}/{m.name}" for m in found.manifests}


def test_networks_and_volumes_keep_the_names_that_compose_gives_them(tmp_path):
    found = imported(
        tmp_path,
        "name: bot\nservices:\n  nav:\n    image: a\n"
        "    networks: {ros: {ipv4_address: 10.1.0.2}, site: {aliases: [n]}}\n"
        "    volumes: ['m:/m', 'maps:/maps']\n"
        "networks:\n  ros: {ipam: {config: [{subnet: 10.1.0.0/16}]}, internal: true}\n"
        "  site: {external: true}\n  spare: {}\n"
        "volumes:\n  m: {labels: [a=b]}\n  maps: {external: true, name: site-maps}\n",
    )
    assert spec(found)["container"]["networks"] == {
        "ros": {"aliases": ["nav"], "ipv4_address": "10.1.0.2"},
        "site": {"aliases": ["nav", "n"]},
    }
    assert spec(found)["container"]["volumes"] == ["bot_m:/m", "maps:/maps"]
    ros = {"name": "bot_ros", "internal": True, "ipam": {"config": [{"subnet": "10.1.0.0/16"}]}}
    assert spec(found, "ros", "Network") == ros
    assert spec(found, "site", "Network") == {"external": True}
    assert spec(found, "bot_m", "Volume") == {"labels": {"a": "b"}}
    assert spec(found, "maps", "Volume") == {"name": "site-maps", "external": True}
    assert told(found) == ["10:3: note: no service is in the network spare, so it gets no manifest"]


def test_what_is_built_is_an_image_each_once(tmp_path):
    (tmp_path / ".dockerignore").write_text("manifests\n")
    for folder in ("docker", "other"):
        (tmp_path / folder).mkdir()
    (tmp_path / "own").mkdir()
    for file in ("docker/nav", "other/Dockerfile"):
        (tmp_path / file).write_text("FROM busybox\n")
    found = imported(
        tmp_path,
        "name: bot\nservices:\n"
        "  nav: {image: 'lab/nav:latest', build: {context: ., target: run, args: [A=1], dockerfile: docker/nav}}\n"
        "  same: {image: lab/nav, build: {context: ., target: run, args: [A=1], dockerfile: docker/nav}}\n"
        "  other: {image: lab/nav, build: ./other}\n"
        "  own: {build: {context: own, dockerfile_inline: 'FROM a', labels: {l: m}}}\n",
    )
    image = {"context": "../..", "dockerfile": "docker/nav", "args": {"A": "1"}, "target": "run"}
    assert spec(found, "lab/nav", "Image") == image
    assert spec(found, "bot-other", "Image") == {"context": "../../other"}
    assert [spec(found, name)["image"] for name in ("nav", "same", "other", "own")] == [
        "lab/nav",
        "lab/nav",
        "bot-other",
        "bot-own",
    ]
    assert spec(found, "bot-own", "Image")["dockerfile"] == "../manifests/dockerfiles/bot-own.Dockerfile"
    assert found.files == {"dockerfiles/bot-own.Dockerfile": "FROM a"}
    assert spec(found, "own")["container"]["labels"] == {"l": "m"}


def test_profiles_are_groups_and_copies_are_services(tmp_path):
    text = (
        "name: bot\nservices:\n  nav: {image: a, depends_on: [worker]}\n"
        "  worker: {image: b, scale: 2, profiles: [tools]}\n"
        "  tools: {image: c, profiles: [tools, sim]}\n  none: {image: d, deploy: {replicas: 0}}\n"
    )
    found = imported(tmp_path, text, profiles=["sim"])
    assert spec(found, "worker", "Group") == {"services": ["worker-1", "worker-2"]}
    assert spec(found, "worker-2")["container"]["container_name"] == "bot-worker-2"
    assert spec(found, "profile-tools", "Group") == {"services": ["worker", "tools"]}
    assert spec(found, "sim", "Group") == {"services": ["tools"]}
    assert spec(found, "compose", "Request")["services"] == ["nav", "tools"]
    assert not load(write(found, tmp_path / "manifests")).errors


def test_a_task_that_others_wait_for_is_not_restarted_when_it_has_ended_well(tmp_path):
    found = imported(
        tmp_path,
        "name: bot\nservices:\n  nav: {image: a, depends_on: {task: {condition: service_completed_successfully}}}\n"
        "  task: {image: b, restart: always}\n",
    )
    assert spec(found, "task")["restart"] == "on-failure"
    assert told(found) == [
        "4:20: warning: some services wait until task has ended, so it is restarted only if it fails"
    ]
    tree = write(found, tmp_path / "manifests")
    assert not load(tree).errors
    path = tree / "services/task.yaml"
    path.write_text(path.read_text().replace("restart: on-failure", "restart: always"))
    assert "a task that is restarted whenever it ends is never completed" in str(load(tree).errors[0])


def test_secrets_and_configs_are_files_that_are_said(tmp_path):
    found = imported(
        tmp_path,
        "name: bot\nservices:\n  nav: {image: a, secrets: [key, {source: env, target: /run/e}], configs: [text]}\n"
        "secrets: {key: {file: ./key}, env: {environment: KEY}}\nconfigs: {text: {content: 'a $${b}'}}\n",
        {"KEY": "secret"},
    )
    assert found.files == {"secrets/env": "secret", "configs/text": "a ${b}"}
    assert found.private == {"secrets/env"}
    assert spec(found)["container"]["volumes"] == [
        {"type": "bind", "source": "../configs/text", "target": "/text", "read_only": True},
        {"type": "bind", "source": "../../key", "target": "/run/secrets/key", "read_only": True},
        {"type": "bind", "source": "../secrets/env", "target": "/run/e", "read_only": True},
    ]
    assert sum(": warning: " in line for line in told(found)) == 4


def test_secrets_of_an_included_file_come_from_the_env_file_beside_it(tmp_path):
    for folder, value in (("arm", "of the arm"), ("base", "of the base")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / ".env").write_text(f"TOKEN={value}\nMODE={folder}\n")
        (tmp_path / folder / "compose.yaml").write_text(
            f"services:\n  {folder}: {{image: a, secrets: [{folder}], configs: [mode_{folder}]}}\n"
            f"secrets: {{{folder}: {{environment: TOKEN}}}}\nconfigs: {{mode_{folder}: {{environment: MODE}}}}\n"
        )
    text = "name: bot\ninclude: [arm/compose.yaml, base/compose.yaml]\n"
    text += "services:\n  nav: {image: a, secrets: [own]}\nsecrets: {own: {environment: TOKEN}}\n"
    found = imported(tmp_path, text, {"TOKEN": "mine"})
    assert found.files["secrets/own"] == found.files["secrets/arm"] == "mine", "the environment comes first"
    (tmp_path / ".env").write_text("OTHER=x\n")
    text = text.replace("secrets: [own]", "").replace("secrets: {own: {environment: TOKEN}}\n", "")
    found = imported(tmp_path, text.replace("image: a, ", "image: a"))
    assert {name: found.files[f"secrets/{name}"] for name in ("arm", "base")} == {
        "arm": "of the arm",
        "base": "of the base",
    }
    assert found.files["configs/mode_base"] == "base"
    assert found.private == {"secrets/arm", "secrets/base"}


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_of_the_cases_imports_and_validates(name, tmp_path):
    folder = tmp_path / name
    shutil.copytree(CASES / name, folder)
    if name == "every_key":
        (folder / "ctx").mkdir(exist_ok=True)
        (folder / "ctx/D").write_text("FROM busybox\n")
    loaded = load_from(folder)
    assert loaded.project, loaded.diagnostics
    found = from_compose(loaded.project, folder / "manifests", folder, text_of)
    assert len(found.errors) == REFUSED.get(name, 0)
    if name not in REFUSED:
        assert not load(write(found, folder / "manifests")).errors


@pytest.mark.slow
def test_three_hundred_services_take_seconds(tmp_path):
    one = WHOLE.partition("  nav:\n")[2].partition("\n  db:\n")[0] + "\n".replace('["8080:80", "127', '["127')
    body = "".join(f"  nav{n}:\n{one}" for n in range(300))
    (tmp_path / "nav.env").write_text("KEY=a\n")
    begun = time.process_time()
    found = imported(tmp_path, WHOLE.replace("  db:\n", f"{body}  db:\n"), {"ROS_DOMAIN_ID": "7"})
    texts = found.texts
    taken = time.process_time() - begun
    assert len(texts) > 300
    assert taken < 9, "seconds of CPU; 3 on an idle machine"
