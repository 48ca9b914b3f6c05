"""`rorg import` of a stranger's project: it ends soon, in words, and touches nothing outside of its folders."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from measured import Measured, measured

SECRET = "root:$6$kept.to.itself:19000:0:99999:7:::"
CPU, MEMORY = 4.0, 200
"""Seconds and MiB of one import, with 0.6 s and 60 MiB of Python's own; machines with other work count slowly."""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "shadow").write_text(f"{SECRET}\nA: b\n")
    (tmp_path / "project").mkdir()
    return tmp_path / "project"


def imported(folder: Path, *words: str, home: str = "/home/of-nobody") -> Measured:
    """What comes of an import; it keeps its limits, whatever it is of."""
    found = measured("import", *words, cwd=folder, env={"HOME": home})
    assert found.code in (0, 2), found
    assert "Traceback" not in found.out
    assert "internal error" not in found.out
    assert SECRET not in found.out
    assert "kept.to.itself" not in found.out
    assert found.cpu < CPU, found.cpu
    assert found.memory < MEMORY, found.memory
    return found


def launch(folder: Path, name: str = "a.launch", text: str = "", top: str = "launch") -> None:
    (folder / name).write_text(f"<{top}>{text}</{top}>")


def include(name: str) -> str:
    return f'<include file="$(dirname)/{name}"/>'


def doubling(folder: Path) -> None:
    launch(folder, text=include("0.launch"))
    for number in range(18):
        launch(folder, f"{number}.launch", include(f"{number + 1}.launch") * 2)
    launch(folder, "18.launch", '<node name="n" pkg="p" type="t"/>')


def doubling_arguments(folder: Path) -> None:
    lines = [f'<arg name="a{n + 1}" value="$(arg a{n})$(arg a{n})"/>' for n in range(40)]
    launch(folder, text='<arg name="a0" value="xxxxxxxx"/>' + "".join(lines))


def many_files(folder: Path) -> None:
    names = [f"n{number}.launch" for number in range(2000)]
    for name in names:
        launch(folder, name)
    launch(folder, text="".join(map(include, names)))


def entities(folder: Path) -> None:
    doubled = "".join(f'<!ENTITY e{n + 1} "&e{n};&e{n};&e{n};&e{n};&e{n};&e{n};&e{n};&e{n};">' for n in range(12))
    head = f'<?xml version="1.0"?><!DOCTYPE launch [<!ENTITY e0 "xxxxxxxxxxxx">{doubled}]>'
    (folder / "a.launch").write_text(f'{head}<launch><arg name="a" value="&e12;"/></launch>')


def huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(3 << 30)


LAUNCHES = {
    "it includes itself twice": lambda f: launch(f, text=include("a.launch") * 2),
    "each includes the next one twice": doubling,
    "arguments that double": doubling_arguments,
    "entities that multiply": entities,
    "2,000 includes": many_files,
    "3,000 nested groups": lambda f: launch(f, text="<group>" * 3000 + "</group>" * 3000),
    "200,000 nested elements": lambda f: launch(f, text="<a>" * 100_000 + "</a>" * 100_000),
    "300,000 nodes": lambda f: launch(f, text='<node name="n"/>' * 300_000),
    "60,000 nodes": lambda f: launch(f, text='<node name="n"/>' * 60_000),
    "an encoding that is none": lambda f: (f / "a.launch").write_text('<?xml version="1.0" encoding="x"?><launch/>'),
    "an include of a pipe": lambda f: (os.mkfifo(f / "pipe"), launch(f, text=include("pipe"))),
    "an include of a device without end": lambda f: launch(f, text='<include file="/dev/zero"/>'),
    "an include of a huge file": lambda f: (launch(f, text=include("huge")), huge(f / "huge")),
    "it is a pipe": lambda f: os.mkfifo(f / "a.launch"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("make", LAUNCHES.values(), ids=LAUNCHES)
def test_an_import_of_any_launch_file_ends_in_words(folder, make):
    make(folder)
    imported(folder, "roslaunch", "a.launch")


def chain(count: int) -> str:
    links = [f"  s{n}: {{extends: s{n + 1}}}" for n in range(count)]
    return "\n".join(["services:", *links, f"  s{count}: {{image: x}}"])


def compose(folder: Path, text: str, name: str = "compose.yaml") -> None:
    (folder / name).write_text(text)


def doubling_includes(folder: Path) -> None:
    for number in range(20):
        compose(folder, f"include: [{number + 1}.yaml, ./{number + 1}.yaml]\n", f"{number}.yaml")
    compose(folder, "services: {a: {image: x}}\n", "20.yaml")
    compose(folder, "include: [0.yaml]\n")


def extended_often(folder: Path) -> None:
    many = "".join(f"      A{n}: b\n" for n in range(20_000))
    services = "".join(f"  s{n}: {{extends: base, environment: {{B: c}}}}\n" for n in range(1500))
    compose(folder, f"services:\n  base:\n    image: x\n    environment:\n{many}{services}")


def long_values(folder: Path) -> None:
    (folder / ".env").write_text(f"A={'x' * 500_000}\n")
    compose(folder, 'services: {a: {image: x, command: ["' + '", "'.join(["${A}"] * 20_000) + '"]}}\n')


def one_env_file_often(folder: Path) -> None:
    (folder / "big.env").write_text("".join(f"A{n}=b\n" for n in range(60_000)))
    services = "".join(f"  s{n}: {{image: x, env_file: [big.env]}}\n" for n in range(300))
    compose(folder, f"services:\n{services}")


def unknown_names(folder: Path) -> None:
    services = "".join(f"  service{n}: {{image: x, depends_on: [server{n}]}}\n" for n in range(4000))
    compose(folder, f"services:\n{services}")


def service(text: str) -> str:
    return f"services:\n  a:\n    image: x\n    {text}\n"


COMPOSES = {
    "each includes the next one twice": doubling_includes,
    "it includes itself by a link": lambda f: (
        compose(f, "include: [./again/compose.yaml]\n"),
        (f / "again").symlink_to("."),
    ),
    "3,000 services that extend each other": lambda f: compose(f, chain(3000)),
    "a large service that is extended often": extended_often,
    "a large env file that is named often": one_env_file_often,
    "a long value that is named often": long_values,
    "names that there are not": unknown_names,
    "20,000 unknown keys": lambda f: compose(f, service("\n    ".join(f"key{n}: 1" for n in range(20_000)))),
    "500,000 items": lambda f: compose(f, f"x-a: [{'1,' * 500_000}1]\nservices: {{a: {{image: x}}}}\n"),
    "all ports a thousand times": lambda f: compose(f, service("ports: [" + '"1-65535:1-65535",' * 1000 + "]")),
    "a NUL in a path": lambda f: compose(f, service('env_file: "a\\0b"')),
    "an env file that is a pipe": lambda f: (os.mkfifo(f / "pipe"), compose(f, service("env_file: pipe"))),
    "an env file that is a device": lambda f: compose(f, service("env_file: /dev/zero")),
    "extends of a pipe": lambda f: (os.mkfifo(f / "pipe"), compose(f, service("extends: {file: pipe, service: a}"))),
    ".env is a pipe": lambda f: (os.mkfifo(f / ".env"), compose(f, service("command: a"))),
    "an ignore file that is a pipe": lambda f: (os.mkfifo(f / ".dockerignore"), compose(f, service("build: ."))),
    "it is a device": lambda f: (f / "compose.yaml").symlink_to("/dev/zero"),
}


@pytest.mark.slow
@pytest.mark.parametrize("make", COMPOSES.values(), ids=COMPOSES)
def test_an_import_of_any_compose_project_ends_in_words(folder, make):
    make(folder)
    imported(folder, "compose")


NUMBER = "9" * 5000
UNITS = {
    "quotes that do not end": 'Environment="A=b',
    "quotes that do not end in a line that goes on": 'Environment="A=b\\\nc',
    "a time that is no number": "TimeoutStopSec=.s",
    "a time with two points": "TimeoutStopSec=1.2.3s",
    "a time without end": f"TimeoutStopSec={NUMBER}",
    "a quota that is no number": "CPUQuota=..%",
    "digits that are no number": "TasksMax=²\nLimitNOFILE=²",
    "more digits than Python reads": f"TasksMax={NUMBER}\nLimitNOFILE={NUMBER}\nMemoryMax={NUMBER}\nCPUQuota={NUMBER}%",
    "a NUL": "User=a\0b",
    "lines that go on": "User=\\\n" + "\\\n" * 500_000,
    "one long word": f"Environment=A={'x' * 900_000}",
}


@pytest.mark.slow
@pytest.mark.parametrize("line", UNITS.values(), ids=UNITS)
def test_an_import_of_any_unit_ends_in_words(folder, line):
    (folder / "nav.service").write_text(f"[Service]\nExecStart=/x\n{line}\n")
    found = imported(folder, "systemd", "nav.service")
    if found.code == 0:
        valid = measured("validate", "manifests", "--engine", "process", cwd=folder)
        assert valid.code == 0, valid.out
    else:
        assert "nav.service" in found.out


@pytest.mark.slow
def test_a_unit_that_is_a_pipe_or_a_device_is_told(folder):
    os.mkfifo(folder / "nav.service")
    assert "not a regular file" in imported(folder, "systemd", "nav.service").out
    (folder / "b.service").symlink_to("/dev/zero")
    assert "not a regular file" in imported(folder, "systemd", "b.service").out


@pytest.mark.slow
@pytest.mark.parametrize(
    "said",
    [
        "extends: {file: ../outside/shadow, service: a}",
        "extends: {file: FULL, service: a}",
        "extends: {file: link, service: a}",
        "env_file: ../outside/shadow",
        "env_file: [{path: FULL, required: false}]",
        "label_file: link",
    ],
)
def test_a_compose_file_names_no_file_outside_of_its_project(folder, said):
    full = str(folder.parent / "outside" / "shadow")
    (folder / "link").symlink_to(full)
    compose(folder, service(said.replace("FULL", full)))
    found = imported(folder, "compose")
    assert found.code == 2
    assert "outside" in found.out
    assert "compose.yaml:4:" in found.out


@pytest.mark.slow
def test_an_include_and_an_env_file_outside_of_the_project_are_refused(folder):
    compose(folder, "include: [{path: ../outside/shadow}]\nservices: {a: {image: x}}\n")
    assert "outside" in imported(folder, "compose").out
    compose(folder, "include: [{path: b.yaml, env_file: ../outside/shadow}]\nservices: {a: {image: x}}\n")
    compose(folder, "services: {b: {image: x}}\n", "b.yaml")
    assert "outside" in imported(folder, "compose").out


def test_a_launch_file_includes_nothing_outside_of_its_project(folder):
    other = folder.parent / "outside" / "other.launch"
    launch(other.parent, other.name, '<node name="hidden" pkg="p" type="t"/>')
    launch(folder, text=f'<include file="{other}"/><node name="own" pkg="p" type="t"/>')
    found = imported(folder, "roslaunch", "a.launch")
    assert found.code == 0
    assert "outside" in found.out
    texts = [path.read_text() for path in (folder / "manifests/services").iterdir()]
    assert not [text for text in texts if "hidden" in text]


@pytest.mark.slow
def test_what_a_person_names_may_be_read(folder):
    compose(folder, service("env_file: ../outside/nav.env"))
    (folder.parent / "outside" / "nav.env").write_text("A=b\n")
    assert "--read" in imported(folder, "compose").out
    assert imported(folder, "compose", "--read", "../outside").code == 0
    assert imported(folder, "compose", "--read", "../outside/nav.env", "--force").code == 0


@pytest.mark.slow
def test_files_of_one_repository_may_name_each_other(folder):
    (folder / ".git").mkdir()
    (folder / "robot").mkdir()
    (folder / "common.env").write_text("A=b\n")
    compose(folder / "robot", service("env_file: ../common.env"))
    assert imported(folder / "robot", "compose", home=str(folder)).code == 2, "a home is no project"
    assert imported(folder / "robot", "compose").code == 0


@pytest.mark.parametrize("kind", ["configs", "secrets"])
def test_no_name_of_a_project_leads_out_of_the_output(folder, kind):
    name = "../../../outside/made"
    compose(folder, f'services: {{a: {{image: x, {kind}: ["{name}"]}}}}\n{kind}: {{"{name}": {{environment: HOME}}}}\n')
    found = imported(folder, "compose")
    assert found.code == 2
    assert "compose.yaml:2:" in found.out
    assert [path.name for path in (folder.parent / "outside").iterdir()] == ["shadow"]


def test_a_link_in_the_output_leads_nowhere(folder):
    (folder / "manifests").mkdir()
    (folder / "manifests" / "configs").symlink_to("../../outside")
    compose(folder, "services: {nav: {image: x, configs: [keys]}}\nconfigs: {keys: {content: mine}}\n")
    assert "leads out" in imported(folder, "compose").out
    assert [path.name for path in (folder.parent / "outside").iterdir()] == ["shadow"]


def test_a_service_of_a_million_copies_is_refused(folder):
    compose(folder, "services: {nav: {image: x, scale: 1000000000}}\n")
    assert "compose.yaml:1:" in imported(folder, "compose").out
