"""Reading Compose files: places, mistakes, variables, and how long it takes."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from rorg.tools.compose import Loaded, load

MISTAKES = {
    "imagge: x": "unknown key 'imagge' in services.a; try 'image'",
    "image: 5": 'services.a.image is a number, and must be text; try "5"',
    'ports: ["80:80:80:80"]': "'80:80:80:80' is not a port",
    "ports: [{published: 3}]": "services.a.ports[0] has no 'target'",
    "environment: [{b: c}]": "services.a.environment[0] is a mapping",
    "privileged: maybe": "'maybe' is neither true nor false",
    "mem_limit: lots": "'lots' is not an amount of memory",
    "healthcheck: {test: [curl, x]}": "does not begin with NONE, CMD or CMD-SHELL",
    "healthcheck: {interval: 5}": "must be a duration, as 1m30s",
    "depends_on: {b: {condition: healthy}}": "'healthy' is not known; try 'service_healthy'",
    "depends_on: [bb]": "service 'a' names service 'bb' in depends_on, which does not exist; try 'b'",
    "network_mode: service:c": "service 'a' names service 'c' in network_mode",
    "volumes: ['a:b:c:d']": "'a:b:c:d' is not a volume",
    "volumes: ['data:/x']": "names 'data', which is not declared in volumes at the top",
    "networks: [n]": "names 'n', which is not declared in networks at the top",
    "secrets: [s]": "names 's', which is not declared in secrets at the top",
    'command: "unclosed \'quote"': "not a command line: a quote is not closed",
    "user: ${U": "'${U' is not a variable: no closing brace",
    "hostname: ${H:?name it}": "variable H is empty or not set: name it",
    "restart: [a]": "services.a.restart is a list, and must be text",
    "env_file: gone.env": "gone.env: No such file or directory",
    "extends: c": "service 'a' extends 'c', which does not exist; try one of b",
    "extends: a": "services extend each other: a -> a",
    "extends: {file: gone.yaml, service: a}": "cannot read the Compose file",
    "ulimits: {nofile: many}": "'many' is not a whole number",
    "extra_hosts: [x]": "'x' is not a host with an address",
    "1: x": 'key 1 is not a text; try "1"',
    "cpus: 1\n    deploy: {resources: {limits: {cpus: 2}}}": "different values for cpus and deploy.resources",
    "container_name: x\n    scale: 2": "has 2 copies",
    "network_mode: host\n    networks: {default: }": "network_mode and networks, which exclude each other",
    "tty: true\n    tty: false": "key 'tty' appears twice in one mapping",
    "<<: 5": "a merge key (<<) takes a mapping",
}
"""Lines of a service: what is said of the first, at its place (line 3 or 4)."""


NAMES = {
    "override": "compose.override.yaml",
    "sub_one": "sub/one.yaml",
    "sub_two": "sub/two.yaml",
    "dotenv": ".env",
    **{f"{name}_env": f"{name}.env" for name in ("b", "e", "l", "raw")},
}


def read(directory: Path, environment: dict[str, str] | None = None, /, **files: str) -> Loaded:
    """What files of these names say, together."""
    for name, text in files.items():
        path = directory / NAMES.get(name, f"{name}.yaml")
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return load([directory], environment or {})


def test_every_mistake_is_told_at_its_place(tmp_path):
    for said, expected in MISTAKES.items():
        image = "" if said.startswith("imag") else "    image: x\n"
        loaded = read(tmp_path, compose=f"services:\n  a:\n    {said}\n{image}  b: {{image: y}}\n")
        assert loaded.project is None, said
        found = [d for d in loaded.errors if expected in str(d)]
        assert found, (said, [str(d) for d in loaded.diagnostics])
        assert found[0].where.file == str(tmp_path / "compose.yaml")
        assert found[0].where.line in (3, 4)


def test_all_mistakes_of_all_files_at_once(tmp_path):
    loaded = read(
        tmp_path,
        compose="include: [sub/one.yaml]\nservices:\n  a: {image: a, cpus: x, env_file: e.env}\n",
        override="services:\n  a: {imag: b}\n",
        sub_one="services:\n  b: {image: b, extends: {file: two.yaml, service: c}}\nvolume: {}\n",
        sub_two="services:\n  c: {tty: perhaps}\n",
        e_env="A B=1\n",
    )
    places = {(Path(d.where.file).name, d.where.line) for d in loaded.errors}
    assert places >= {("compose.yaml", 3), ("one.yaml", 3), ("two.yaml", 2), ("e.env", 1)}


def test_what_is_wrong_as_yaml_is_told(tmp_path):
    for text in ("services: [", "a: &a [*a]", "services: {a: *gone}", "{" * 200, "\x00"):
        loaded = read(tmp_path, compose=text)
        assert loaded.project is None, text
        assert loaded.errors[0].where.file.endswith("compose.yaml")


def test_places_go_through_anchors_extends_and_several_files(tmp_path):
    project = read(
        tmp_path,
        compose=(
            "x-env: &env\n  A: 1\nservices:\n  a:\n    image: a\n    environment:\n      <<: *env\n      B: 2\n"
            "  b:\n    extends: {file: other.yaml, service: base}\n    environment: [C=3]\n"
        ),
        other="services:\n  base:\n    image: base\n    env_file: b.env\n    ports:\n      - 80:80\n",
        b_env="# drivers\nD=4\n",
    ).project
    assert project is not None

    def place(*path: str | int) -> str:
        where = project.where("services", *path)
        return f"{Path(where.file).name}:{where.line}:{where.column}"

    assert place("a", "environment", "A") == "compose.yaml:2:3"
    assert place("a", "environment", "B") == "compose.yaml:8:7"
    assert place("b", "image") == "other.yaml:3:5"
    assert place("b", "ports", 0, "target") == "other.yaml:6:9"
    assert place("b", "environment", "C") == "compose.yaml:11:19"
    assert place("b", "environment", "D") == "b.env:2:1"
    assert place("b", "nothing", "there") == "compose.yaml:9:3"


def test_which_variables_were_taken(tmp_path):
    project = read(
        tmp_path,
        {"DISPLAY": ":0", "TAG": "process"},
        compose="services:\n  a:\n    image: x:${TAG}-${FLAVOUR:-plain}\n    environment: [DISPLAY, NOT_SET]\n",
        dotenv="TAG=file\nFLAVOUR=gpu\n",
    ).project
    assert project is not None
    assert project.services["a"]["image"] == "x:process-gpu"
    assert project.taken["services", "a", "image"] == ("TAG", "FLAVOUR")
    assert project.taken["services", "a", "environment", "DISPLAY"] == ("DISPLAY",)
    assert project.services["a"]["environment"] == {"DISPLAY": ":0", "NOT_SET": None}
    assert {name: v.value for name, v in project.variables.items()} == {
        **{"TAG": "process", "FLAVOUR": "gpu"},
        **{"DISPLAY": ":0", "NOT_SET": None},
    }
    assert project.variables["TAG"].file is None
    assert str(project.variables["FLAVOUR"].file).endswith(".env:2:1")


def test_a_variable_that_is_not_set_is_a_warning_where_it_stands(tmp_path):
    loaded = read(tmp_path, compose="services:\n  a:\n    image: x${GONE}\n")
    assert loaded.project is not None
    (warning,) = loaded.diagnostics
    assert (warning.severity, warning.where.line, warning.where.column) == ("warning", 3, 12)


def test_rings_of_needs_and_of_includes_are_told_once(tmp_path):
    loaded = read(
        tmp_path,
        compose=(
            "include: [i.yaml]\nservices:\n  a: {image: x, depends_on: [b]}\n  b: {image: x, links: [c]}\n"
            "  c: {image: x, network_mode: 'service:a'}\n  d: {image: x, depends_on: [a]}\n"
        ),
        i="include: [compose.yaml]\n",
    )
    rings = [d.message for d in loaded.errors if "each other" in d.message]
    assert rings == [
        "services need each other: a -> b -> c -> a",
        "files include each other: compose.yaml -> i.yaml -> compose.yaml",
    ]


def test_gpus_and_keys_that_came_later(tmp_path):
    project = read(
        tmp_path,
        compose=(
            "services:\n  a: {image: x, gpus: all, label_file: l.env}\n  b:\n    image: x\n"
            "    gpus: [{driver: nvidia, count: 1, capabilities: [gpu]}]\n"
            "    env_file: [{path: raw.env, format: raw}]\n"
        ),
        l_env="part=arm\n",
        raw_env="A='as it $stands'\n",
    ).project
    assert project is not None
    assert project.services["a"]["gpus"] == [{"count": -1}]
    assert project.services["a"]["labels"] == {"part": "arm"}
    assert project.services["b"]["gpus"] == [{"driver": "nvidia", "count": 1, "capabilities": ["gpu"]}]
    assert project.services["b"]["environment"] == {"A": "'as it $stands'"}


def test_services_of_all_profiles_are_there_and_those_enabled_are_named(tmp_path):
    text = "services:\n  a: {image: x}\n  b: {image: x, profiles: [sim]}\n  c: {image: x, profiles: [real, sim]}\n"
    (tmp_path / "compose.yaml").write_text(text)
    for profiles, enabled in (((), "a"), (("real",), "ac"), (("*",), "abc")):
        project = load([tmp_path], {}, profiles=profiles).project
        assert project is not None
        assert (set(project.services), project.enabled) == ({"a", "b", "c"}, frozenset(enabled))
    assert project.profiles == {"b": ("sim",), "c": ("real", "sim")}


@pytest.mark.slow
def test_three_hundred_services_are_read_fast(tmp_path):
    one = (
        "  s{i}:\n    <<: *ros\n    command: roslaunch a b{i}.launch\n"
        "    depends_on: [s{before}]\n    ports: ['{port}:80']\n"
    )
    head = "x-ros: &ros\n  image: ros:${TAG:-1}\n  environment: {A: 1, B: '${B:-2}'}\n  volumes: ['./a:/a:ro']\n"
    services = "".join(one.format(i=i, before=i - 1, port=1000 + i) for i in range(1, 300))
    text = f"{head}services:\n  s0: {{image: x}}\n{services}"
    began = time.process_time()
    project = read(tmp_path, compose=text).project
    assert project is not None
    assert len(project.services) == 300
    assert time.process_time() - began < 3
