"""Variables of a tree: what robot.env declares, in the values of manifests. And files of variables of a service."""

from __future__ import annotations

import time

import pytest
from repositories import Repository
from robots import write_tree

from rorg.daemon.commit_tree import load_at
from rorg.daemon.tree import Tree
from rorg.manifest.dotenv import read_dotenv
from rorg.manifest.effective import effective
from rorg.manifest.load import load
from rorg.manifest.variables import NONE, Variables, fill
from rorg.manifest.yaml_source import Document

KNOWN = Variables({"SPEED": "5", "EMPTY": "", "low": "l", "MANY": "$SPEED ${SPEED}"}, {}, True)


def service(tree, name: str = "arm", robot: str = ""):
    loaded = load(tree, robot=robot)
    assert loaded.catalog, list(map(str, loaded.errors))
    return loaded.catalog.services[name]


def said(tree, robot: str = "") -> list[str]:
    return [str(d).replace(f"{tree}/", "") for d in load(tree, robot=robot).diagnostics]


@pytest.fixture
def tree(tmp_path):
    spec = {
        "command": ["echo", "${SPEED}"],
        "priority": "${PRIORITY}",
        "container": {"environment": {"NAME": "${NAME}", "RATE": "${RATE:-1.50}"}},
    }
    root = write_tree(tmp_path / "tree", {"arm": spec})
    (root / "robot.env").write_text("# of all robots\nSPEED=5\nPRIORITY=20\nNAME='base $x'\n")
    return root


# -- one text ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("${SPEED}", "5"),
        ("at ${SPEED} m/s, ${SPEED}", "at 5 m/s, 5"),
        ("${low}", "l"),
        ("${EMPTY}", ""),
        ("${EMPTY:-x}${EMPTY-y}", "x"),
        ("${OTHER:-x}${OTHER-y}", "xy"),
        ("${SPEED:-x}", "5"),
        ("${OTHER:-${SPEED}}", "5"),
        ("${OTHER:-{a}}", "{a}"),
        ("${SPEED:+fast}${OTHER:+slow}", "fast"),
        ("${SPEED:?must be there}", "5"),
        ("${MANY}", "$SPEED ${SPEED}"),
        ("$${SPEED}", "${SPEED}"),
        ("$$${SPEED}", "$5"),
        ("$$$${SPEED}", "$${SPEED}"),
        # Not a form of ours: a shell's, a profile's, a regular expression's.
        ("$SPEED", "$SPEED"),
        ("$$", "$$"),
        ("kill $$ $(date) $1 ${1} ${#}", "kill $$ $(date) $1 ${1} ${#}"),
        ("${service} $${service} ${resources.cpu} ${rorg.run}", "${service} $${service} ${resources.cpu} ${rorg.run}"),
        ("${name} ${name:-x} ${name%x}", "${name} ${name:-x} ${name%x}"),
        ("${OTHER:-${service}}", "${service}"),
        ("^a$|{b}", "^a$|{b}"),
    ],
)
def test_what_a_text_becomes(text, expected):
    document, found = fill(Document("a.yaml", {"kind": "Service", "spec": {"a": [text]}}), KNOWN)
    assert (document.value["spec"]["a"], found) == ([expected], [])


@pytest.mark.parametrize(
    "text", ["${OTHER}", "${OTHER:?x}", "${EMPTY:?x}", "${SPEED%x}", "${SPEED", "x ${A:-${OTHER}}"]
)
def test_what_is_refused(text):
    _, found = fill(Document("a.yaml", {"kind": "Service", "spec": {"a": text}}), KNOWN)
    assert len(found) == 1
    assert found[0].remedy


def test_only_values_of_spec_are_filled_in():
    value = {"kind": "Service", "metadata": {"name": "${SPEED}"}, "spec": {"${SPEED}": 1}}
    document = Document("a.yaml", value)
    assert fill(document, KNOWN) == (document, [])


def test_without_a_file_of_variables_nothing_is_looked_for(tmp_path):
    """An upgrade of rorg changes nothing of a tree that has none."""
    words = ["echo", "${SPEED}", "$${SPEED}", "${SPEED%x}"]
    root = write_tree(tmp_path, {"arm": {"command": words, "container": {"environment": {"A": "${SPEED}"}}}})
    arm = service(root)
    assert arm.spec["command"] == words
    assert arm.spec["environment"]["A"] == "${SPEED}"
    document = Document("a.yaml", {"kind": "Service", "spec": {"a": "${SPEED}"}})
    assert fill(document, NONE) == (document, [])


# -- a tree ------------------------------------------------------------------------------------------------------


def test_what_a_robot_declares_wins_over_what_all_do(tree):
    (tree / "robots/nora").mkdir(parents=True)
    (tree / "robots/nora/robot.env").write_text("SPEED=7\nNAME=${SPEED}-${PRIORITY}\nRATE=2.0\n")
    base, nora = service(tree), service(tree, robot="nora")
    assert (base.spec["command"], nora.spec["command"]) == (["echo", "5"], ["echo", "7"])
    assert (base.priority, nora.priority) == (20, 20)
    assert [s.spec["environment"]["NAME"] for s in (base, nora)] == ["base $x", "7-20"]
    assert [s.spec["environment"]["RATE"] for s in (base, nora)] == ["1.50", "2.0"]


def test_the_environment_of_the_process_counts_for_nothing(tree, monkeypatch):
    monkeypatch.setenv("SPEED", "9")
    monkeypatch.setenv("SECRET", "9")
    assert service(tree).spec["command"] == ["echo", "5"]
    (tree / "robot.env").write_text("PRIORITY=1\nNAME=${SECRET}\nSECRET\nSPEED=1\n")
    assert [line.partition(": error: ")[0] for line in said(tree)] == ["robot.env:2:1", "robot.env:3:1"]


def test_fields_of_numbers_take_what_yaml_reads_and_texts_stay_texts(tmp_path):
    options = {"init": "${YES}", "pids_limit": "${COUNT}", "hostname": "${COUNT}", "shm_size": "${COUNT}Mi"}
    pairs = {"A": "${YES}", "B": "${HALF}", "C": "${HEX}"}
    spec = {
        "always_on": "${YES}",
        "resources": {"cpu": "${HALF}"},
        "ready": {"tcp": "${HEX}", "timeout": "${COUNT}"},
        "container": {**options, "environment": pairs, "ulimits": {"nofile": {"soft": "${COUNT}", "hard": 64}}},
    }
    root = write_tree(tmp_path, {"arm": spec})
    (root / "robot.env").write_text("YES=True\nCOUNT=12\nHALF=0.50\nHEX=0x10\n")
    arm = service(root)
    assert (arm.always_on, arm.cpu, arm.ready.target, arm.ready.timeout) == (True, 0.5, "127.0.0.1:16", 12.0)
    assert [arm.spec[o] for o in options] == [True, 12, "12", 12 << 20]
    assert [arm.spec["environment"][n] for n in pairs] == ["True", "0.50", "0x10"]
    assert arm.spec["ulimits"] == {"nofile": {"soft": 12, "hard": 64}}


def test_a_mistake_says_which_variable_it_comes_from(tree):
    (tree / "robots/nora").mkdir(parents=True)
    (tree / "robots/nora/robot.env").write_text("\nPRIORITY=many\n")
    assert "integer (PRIORITY is set at robots/nora/robot.env:2)" in said(tree, "nora")[0]
    write_tree(tree, {"arm": {"needs": ["${NAME}"]}})
    (tree / "robot.env").write_text("NAME=lidar\n")
    assert said(tree)[0].endswith("needs unknown service 'lidar' (NAME is set at robot.env:1); try one of developer")


def test_a_name_alone_takes_the_value_of_the_variable(tmp_path):
    spec = {"profile": "robots", "container": {"environment": ["SPEED", "A=b"]}}
    root = write_tree(tmp_path, {"arm": spec}, profiles={"robots": {"container": {"environment": {"NAME": None}}}})
    assert [line.partition(": error: ")[0] for line in said(root)] == [
        "profiles/robots.yaml:8:13",
        "services/arm.yaml:21:7",
    ]
    (root / "robot.env").write_text("SPEED=5\nNAME=nora\n")
    environment = service(root).spec["environment"]
    assert [environment[name] for name in ("SPEED", "A", "NAME")] == ["5", "b", "nora"]
    (root / "images/eye").mkdir(parents=True)
    (root / "images/eye/Dockerfile").write_text("FROM scratch\n")
    head = "apiVersion: rorg/v1\nkind: Image\nmetadata: {name: eye}\n"
    (root / "images/eye.yaml").write_text(f"{head}spec: {{context: eye, args: [SPEED, NAME=x]}}\n")
    assert load(root).catalog.images["eye"].args == {"SPEED": "5", "NAME": "x"}


def test_explain_says_that_a_value_came_from_a_variable(tree):
    values = {v.field: v for v in effective(tree, "arm")}
    place = f"{tree}/robot.env"
    assert values["priority"].source.endswith(f", PRIORITY of {place}:3")
    assert values["container.environment.NAME"].source.endswith(f", NAME of {place}:4")
    assert values["command"].as_json()["source"]["variables"] == [{"name": "SPEED", "file": place, "line": 2}]
    assert "variables" not in values["container.environment.RATE"].as_json()["source"], "its default holds"


def test_the_loop_sees_that_variables_change(tree):
    (tree / "robots/nora").mkdir(parents=True)
    watched = Tree(tree, named="nora")
    watched.read()
    speed = lambda: watched.desired.catalog.services["arm"].spec["command"][1]  # noqa: E731
    assert speed() == "5"
    assert watched.read() == (False, False)
    for path, value in (("robots/nora/robot.env", "77"), ("robot.env", "666"), ("robots/nora/robot.env", "")):
        file = tree / path
        assert file.parent in watched.folders()
        file.write_text(f"SPEED={value}\nPRIORITY=1\nNAME=x\n") if value else file.unlink()
        assert watched.read() == (True, False)
    assert speed() == "666"
    (tree / "robot.env").unlink()
    assert watched.read() == (True, False)
    assert watched.errors, "the priority is text that nothing is filled into"
    assert speed() == "666", "the last good one holds"


def test_a_state_of_the_past_has_the_variables_of_then(tmp_path):
    repository = Repository(tmp_path / "repository")
    repository.service("arm", "{image: x, container: {hostname: '${NAME}'}}")
    names = []
    for name in ("nora", "mira"):
        repository.write("manifests/robot.env", f"NAME={name}\n")
        names.append((name, repository.commit()))
    for name, commit in names:
        assert load_at(Tree(repository.tree), commit).catalog.services["arm"].spec["hostname"] == name


# -- files of variables of a service -----------------------------------------------------------------------------


def test_an_env_file_is_read_as_compose_reads_it(tmp_path):
    files = ["a.env", {"path": "b.env"}, {"path": "raw.env", "format": "raw"}, {"path": "no.env", "required": False}]
    root = write_tree(tmp_path, {"arm": {"profile": "plain", "container": {"env_file": files}}})
    (root / "robot.env").write_text("SPEED=5\n")
    (root / "services/a.env").write_text(
        '# one\nexport A="x y" # two\nB=\'$SPEED\'\nC=${SPEED}-$A\n\nD=a#b\nE = f  \nF="1\n2"\nSPEED\n'
    )
    (root / "services/b.env").write_text("G=${C:-none}\nE=g\n")
    (root / "services/raw.env").write_text('H="$A" # all of it\n')
    wanted = {"A": "x y", "B": "$SPEED", "C": "5-x y", "D": "a#b", "E": "g", "F": "1\n2", "SPEED": "5", "G": "5-x y"}
    arm = service(root)
    assert arm.spec["environment"] == wanted | {"H": '"$A" # all of it'}
    assert set(arm.secrets) == {*wanted, "H"}


def test_what_an_env_file_leaves_open_is_a_warning(tmp_path):
    root = write_tree(tmp_path, {"arm": {"profile": "plain", "container": {"env_file": "arm.env"}}})
    (root / "services/arm.env").write_text("A=1\nHOME\nB=x$y\n")
    assert service(root).spec["environment"] == {"A": "1", "B": "x"}
    told = [line for line in said(root) if "arm.env" in line]
    assert [line.partition(": ")[::2][1][:7] for line in told] == ["warning", "warning"]
    assert [line.partition(": ")[0] for line in told] == ["services/arm.env:2:1", "services/arm.env:3:1"]


def test_a_file_that_a_profile_names_and_that_is_missing_is_told_at_the_profile(tmp_path):
    spec = {"profile": "robots", "container": {"env_file": ["arm.env"], "security_opt": ["seccomp:arm.json"]}}
    shared = {"container": {"env_file": ["all.env"], "security_opt": ["seccomp:all.json", "label:disable"]}}
    root = write_tree(tmp_path, {"arm": spec, "lidar": {"profile": "robots"}}, profiles={"robots": shared})
    (root / "services/all.env").write_text("A=1\n")
    (root / "services/arm.json").write_text('{ "defaultAction": "SCMP_ACT_ALLOW" }')
    arm, lidar = said(root)
    assert arm.startswith("services/arm.yaml:21:7: error: env_file 'arm.env': No such file")
    assert lidar.startswith("services/lidar.yaml:18:12: error: seccomp profile 'all.json': No such file")
    assert "which profile robots declares" in lidar
    (root / "services/arm.env").write_text("B=1\n")
    (root / "services/all.json").write_text("{}")
    assert service(root).spec["security_opt"][1:] == ["label:disable", 'seccomp={"defaultAction":"SCMP_ACT_ALLOW"}']


def test_long_forms_and_short_ones_are_one_configuration(tmp_path):
    long = {
        "ports": [{"target": 80}, {"target": 81, "published": "8081", "protocol": "udp", "host_ip": "::1"}],
        "devices": [{"source": "/dev/null"}, {"source": "/dev/zero", "target": "/dev/arm", "permissions": "r"}],
        "env_file": {"path": "arm.env", "required": True},
        "network_mode": "bridge",
    }
    short = {
        "ports": ["80", "[::1]:8081:81/udp"],
        "devices": ["/dev/null", "/dev/zero:/dev/arm:r"],
        "env_file": ["arm.env"],
        "network_mode": "bridge",
    }
    root = write_tree(tmp_path, {"arm": {"container": long}, "Arm2": {"container": short}})
    (root / "services/arm.env").write_text("A=1\n")
    specs = [{**service(root, name).spec, "environment": {}} for name in ("arm", "Arm2")]
    assert specs[0] == specs[1]


@pytest.mark.slow
def test_a_large_file_costs_no_more_a_line_than_a_small_one():
    """Whoever may commit to the tree shall not hold up the loop."""

    def cost(lines: int) -> float:
        began = time.process_time()
        entries, _ = read_dotenv("A=1\n" * lines + "LAST=${A}\n", lambda _: None)
        assert (entries[-1].line, entries[-1].value) == (lines + 1, "1")
        return (time.process_time() - began) / lines

    costs = [min(cost(lines) for _ in range(3)) for lines in (2_000, 20_000)]
    assert costs[1] < 4 * costs[0]
