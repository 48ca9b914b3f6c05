"""Own programs on the process engine: where they begin, what they have of the environment, and what is told of those
that cannot begin."""

from __future__ import annotations

import json
from pathlib import Path

import commands
import pytest
from common import wait_for
from robots import write_tree
from rorg_process import RorgProcess

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.engines.docker.body import create_body
from rorg.engines.process.engine import ProcessEngine
from rorg.errors import EngineError
from rorg.manifest.load import load, load_or_raise

SAYS = """#!/bin/sh
echo "in $PWD"; echo "robot $ROBOT"; echo "speed $SPEED"; echo "ros ${ROS_DISTRO-none}"; echo "secret ${SECRET-none}"
echo said; exec sleep 1000
"""


def script(path: Path, text: str = SAYS, mode: int = 0o755) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(mode)


@pytest.fixture
def tree(tmp_path) -> Path:
    """A manifest that names its program, its directory and its variables by paths beside it."""
    found = write_tree(
        tmp_path / "tree",
        {
            "arm": {
                "command": ["./programs/arm.sh"],
                "always_on": True,
                "inherit_environment": ["ROS_*"],
                "container": {"env_file": "arm.env", "environment": {"SPEED": "2"}},
            }
        },
    )
    script(found / "services/programs/arm.sh")
    (found / "services/arm.env").write_text("# of the robot\nROBOT=fetch\nSPEED=1\n")
    return found


@pytest.fixture
def engine(process_engine):
    return process_engine


def begin(engine: ProcessEngine, spec: dict) -> str:
    made = engine.create("x", {"image": "x", **spec}, {LABEL_OWNER: "me", LABEL_SERVICE: "x"})
    engine.start(made)
    return made


def said(engine: ProcessEngine, container: str) -> list[str]:
    def lines() -> list[str]:
        return b"".join(line.text for line in engine.log_lines(container, None, None, False)).decode().splitlines()

    wait_for(lambda: "said" in lines(), what="the program to say where it is")
    return lines()


def test_a_program_begins_beside_its_manifest_with_its_own_variables(tree, engine, monkeypatch):
    monkeypatch.setenv("ROS_DISTRO", "noetic")
    monkeypatch.setenv("SECRET", "of rorg")
    spec = load_or_raise(tree, "process").services["arm"].spec
    lines = said(engine, begin(engine, dict(spec)))
    assert lines == [f"in {tree}/services", "robot fetch", "speed 2", "ros noetic", "secret none", "said"]


@pytest.mark.parametrize(("asked", "found"), [("all", "of rorg"), (["SECRET"], "of rorg"), (["SEC"], "none")])
def test_the_environment_of_rorg_is_had_on_request(tree, engine, monkeypatch, asked, found):
    monkeypatch.setenv("SECRET", "of rorg")
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/systemd/notify")
    write_tree(tree, {"arm": {"command": ["./programs/arm.sh"], "inherit_environment": asked}})
    container = begin(engine, dict(load_or_raise(tree, "process").services["arm"].spec))
    assert f"secret {found}" in said(engine, container)
    assert engine.exec(container, ["printenv", "NOTIFY_SOCKET"], 5.0) == (1, b"")


def test_a_declared_directory_is_beside_the_manifest_too(tree, engine):
    (tree / "work").mkdir()
    options = {"working_dir": "../work"}
    write_tree(tree, {"arm": {"command": ["../services/programs/arm.sh"], "container": options}})
    container = begin(engine, dict(load_or_raise(tree, "process").services["arm"].spec))
    assert f"in {tree}/work" in said(engine, container)
    assert engine.exec(container, ["pwd"], 5.0) == (0, f"{tree}/work\n".encode())


def test_containers_have_nothing_of_it(tree):
    """Their digests, too, are what they were: a robot's containers are not made anew."""
    loaded = load(tree, engine="docker")
    assert [(d.severity, d.message.partition(":")[0]) for d in loaded.diagnostics] == [
        ("warning", "the docker engine ignores inherit_environment")
    ]
    spec = loaded.catalog.services["arm"].spec
    assert not {"working_dir", "inherit_environment"} & set(spec)
    assert "WorkingDir" not in create_body({**spec, "inherit_environment": ["*"]}, {})
    write_tree(tree, {"arm": {"container": {"working_dir": "./programs"}}})
    assert "the docker engine needs one of the container" in str(load(tree, engine="docker").errors[0])
    assert load(tree).errors == []


CANNOT = [
    ({"working_dir": "/no/such/place"}, "no directory /no/such/place", "to create it"),
    ({"command": ["no-such-program"]}, "no program 'no-such-program' on this machine", "`rorg build`"),
    ({"command": ["./nothing.sh"]}, "no program {folder}/nothing.sh", "to create it"),
    ({"command": ["/opt/nothing"]}, "no program /opt/nothing", "to create it"),
    ({"command": ["./plain.sh"]}, "{folder}/plain.sh is not executable", "chmod +x"),
    ({"command": ["./lost.sh"]}, "is a script for /no/python, which is not installed", "to install that"),
    ({"command": []}, "no program is named", "`rorg build`"),
]


@pytest.mark.parametrize(("spec", "why", "remedy"), CANNOT, ids=lambda v: v if isinstance(v, str) else "")
def test_what_cannot_begin_is_an_error_with_cause_and_remedy(engine, tmp_path, spec, why, remedy):
    script(tmp_path / "plain.sh", mode=0o644)
    script(tmp_path / "lost.sh", "#!/no/python\n")
    with pytest.raises(EngineError) as told:
        begin(engine, {"command": ["sleep", "1000"], "working_dir": str(tmp_path), **spec})
    assert why.format(folder=tmp_path) in told.value.why
    assert told.value.remedy.startswith(remedy)


def validate(tree: Path, *words: str, code: int = 0) -> list[dict]:
    """Findings, as JSON."""
    return json.loads(commands.rorg("validate", str(tree), "-o", "json", *words, code=code).stdout)


def test_validate_checks_for_an_engine_that_is_named(tree):
    write_tree(
        tree,
        {
            "gone": {"command": ["./gone.sh"]},
            "nowhere": {"container": {"working_dir": "./nowhere"}},
            "machine": {"command": ["no-such-program"]},
            "folder": {"container": {"working_dir": "/no/such/place"}},
            "fine": {"command": ["./programs/arm.sh"]},
        },
    )
    assert validate(tree) == []
    found = {Path(d["file"]).stem: (d["severity"], d["message"]) for d in validate(tree, "--engine", "process", code=2)}
    assert found == {
        "gone": ("error", f"no program {tree}/services/gone.sh"),
        "nowhere": ("error", f"no directory {tree}/services/nowhere"),
        "machine": ("warning", "no program 'no-such-program' on this machine"),
        "folder": ("warning", "no directory /no/such/place"),
    }
    assert {Path(d["file"]).stem for d in validate(tree, "--engine", "docker", code=2)} == {"nowhere"}


IGNORED, NETWORK = "the process engine ignores", "a process uses the network of this machine"
FILES = IGNORED + " {}: a process sees the files of this machine"


def test_validate_names_what_processes_ignore_and_where(tree):
    (tree / "services/maps").mkdir(parents=True)
    for name, mode in (("arm", "none"), ("base", "host"), ("lidar", "service:base")):
        (tree / f"services/{name}.yaml").write_text(
            f"apiVersion: rorg/v1\nkind: Service\nmetadata: {{name: {name}}}\nspec:\n  image: debian\n"
            f"  command: [sleep, '9']\n  mounts: ['maps:/maps']\n"
            f"  container:\n    volumes: ['/srv:/srv']\n    network_mode: {mode}\n"
        )
    assert not [d for d in validate(tree) if "process engine" in d["message"]]
    told = [d for d in validate(tree, "--engine", "process") if "process engine" in d["message"]]
    assert {(d["severity"], d["line"], d["column"], d["message"], d["remedy"]) for d in told} == {
        ("warning", 7, 3, FILES.format("mounts"), "paths of this machine in the command"),
        ("warning", 9, 5, FILES.format("volumes"), "paths of this machine in the command"),
        ("warning", 10, 19, f"{IGNORED} network_mode: none: {NETWORK}", "network_mode: host"),
    }
    assert [Path(d["file"]).stem for d in told if "network_mode" in d["message"]] == ["arm"]


def test_the_loop_refuses_a_tree_without_its_program_until_it_is_there(tmp_path):
    robot = RorgProcess(tmp_path, {"arm": {"always_on": True}}).start()
    try:
        client = robot.client()
        wait_for(lambda: client.service("arm")["state"] == "running")
        write_tree(robot.tree, {"arm": {"always_on": True, "command": ["./arm.sh"]}})
        wait_for(lambda: client.status()["tree"]["errors"])
        assert "no program" in client.status()["tree"]["errors"][0]["message"]
        assert client.service("arm")["state"] == "running"
        script(robot.tree / "services/arm.sh")
        wait_for(lambda: not client.status()["tree"]["errors"], what="the program to be found")
        wait_for(lambda: client.service("arm")["sync"] == "Synced" and client.service("arm")["state"] == "running")
    finally:
        robot.close()


@pytest.mark.parametrize("wrong", ["all of it", ["A-B"], ["$HOME"], 3])
def test_other_words_for_the_environment_are_refused(tree, wrong):
    write_tree(tree, {"arm": {"inherit_environment": wrong}})
    assert any("inherit_environment" in d.message for d in load(tree).errors), load(tree)
