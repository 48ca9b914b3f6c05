"""A service with `may_manage` gets no variable, no file and no right by the manifests that it writes."""

from __future__ import annotations

import pytest
import yaml
from robots import WORK, RealRobot

from rorg.client import Error, Forbidden

PIN = "482913-of-the-vault"
BOSS = {"always_on": True, "may_manage": ["lab-*"], "may_request": ["camera"]}
VAULT = {"secrets": ["PIN"], "container": {"environment": {"PIN": "${PIN}"}}}
KEPT = {"command": [*WORK, "${SPEED}"], "container": {"pids_limit": 9000, "annotations": {"a": "b"}}}
TREE = {"boss": BOSS, "camera": {}, "vault": VAULT, "lab-kept": KEPT}
PROFILES = {
    "lab-arm": {"container": {"devices": ["/dev/null"], "environment": {"LIMIT": "${SPEED}"}}},
    "lab-bare": {"common": False},
    "gripper": {"container": {"devices": ["/dev/null"]}},
}


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.tree.mkdir()
    (found.tree / "robot.env").write_text(f"SPEED=5\nPIN={PIN}\nsmall={PIN}\n")
    found.declare(TREE, profiles=PROFILES)
    found.wait(lambda: "boss" in found.active())
    yield found
    found.close()


def put(robot: RealRobot, spec: dict, name: str = "lab-x", base: str | None = None) -> None:
    body = {"apiVersion": "rorg/v1", "kind": "Service", "metadata": {"name": name}, "spec": spec}
    spec = {"image": "x", "command": WORK, **spec}
    text = yaml.safe_dump({**body, "spec": spec}, sort_keys=False)
    robot.client("boss").put_manifest("Service", name, text, base)


def refusal(robot: RealRobot, spec: dict, name: str = "lab-x", base: str | None = None) -> str:
    with pytest.raises(Forbidden) as refused:
        put(robot, spec, name, base)
    return str(refused.value)


def base_of(robot: RealRobot, name: str) -> str:
    return next(m["digest"] for m in robot.client("boss").manifests() if m["name"] == name)


VARIABLES = {
    "command": {"command": ["echo", "${%s}"]},
    "image": {"image": "elsewhere.example:5000/${%s}"},
    "value": {"container": {"environment": {"X": "${%s}"}}},
    "bare": {"container": {"environment": ["%s"]}},
    "null": {"container": {"environment": {"%s": None}}},
    "default": {"command": ["echo", "${%s:-none}"]},
    "nested": {"command": ["echo", "${SPEED:+$%s}"]},
    "required": {"command": ["echo", "${LACKING:?${%s}}"]},
    "number": {"priority": "${%s}"},
}


def named(spec: object, variable: str) -> object:
    """A spec with the name of a variable in it."""
    if isinstance(spec, dict):
        return {named(k, variable): named(v, variable) for k, v in spec.items()}
    if isinstance(spec, list):
        return [named(v, variable) for v in spec]
    return spec.replace("%s", variable) if isinstance(spec, str) else spec


@pytest.mark.slow
@pytest.mark.parametrize("spec", VARIABLES.values(), ids=VARIABLES)
def test_a_manager_reads_no_variable(robot, spec):
    said = refusal(robot, named(spec, "PIN"))
    assert "variable" in said
    if "SPEED" not in str(spec):
        assert said == refusal(robot, named(spec, "NIP")).replace("NIP", "PIN")
    if "number" not in str(spec):
        refusal(robot, named(spec, "small"))
    told = list(robot.client().events(tail=10_000))
    assert PIN not in str(told)
    assert "elsewhere.example" not in str(told)


def test_a_manager_keeps_the_variables_of_a_manifest_that_a_person_wrote(robot):
    put(robot, {**KEPT, "priority": 7}, "lab-kept", base_of(robot, "lab-kept"))
    assert "PIN" in refusal(robot, {**KEPT, "image": "${PIN}"}, "lab-kept", base_of(robot, "lab-kept"))
    put(robot, {"profile": "lab-arm"})


FILES = {
    "env_file": {"container": {"env_file": ["%s"]}},
    "seccomp": {"container": {"security_opt": ["seccomp=%s"]}},
    "mounts": {"mounts": ["../../%s:/x"]},
    "volume": {"container": {"volumes": ["%s:/x"]}},
}


@pytest.mark.slow
@pytest.mark.parametrize("spec", FILES.values(), ids=FILES)
def test_a_manager_learns_nothing_of_files(robot, tmp_path, spec):
    secret = tmp_path / "secret.env"
    secret.write_text("root:$6$secret hash:19000:0\n")
    there = refusal(robot, named(spec, str(secret)))
    assert "root" not in there
    assert "hash" not in there
    assert there == refusal(robot, named(spec, f"{secret}.none")).replace(f"{secret}.none", str(secret))


def test_a_manager_is_told_nothing_of_files_that_others_name(robot, tmp_path):
    (tmp_path / "secret.env").write_text("the secret hash of root\n")
    profiles = {**PROFILES, "lab-file": {"container": {"env_file": [str(tmp_path / "secret.env")]}}}
    robot.declare(TREE, profiles=profiles)
    with pytest.raises(Error) as refused:
        put(robot, {"profile": "lab-file"})
    assert "hash" not in str(refused.value)


MORE = {
    "no-new-privileges": {"profile": "plain"},
    "ipc": {"profile": "ros2"},
    "screen": {"profile": "x11"},
    "gpu": {"profile": "gpu"},
    "realtime": {"profile": "realtime"},
    "two": {"profile": ["lab-arm", "plain"]},
    "other-profile": {"profile": "gripper"},
    "root": {"container": {"user": "0"}},
    "root-group": {"container": {"user": "root:root"}},
    "pids": {"container": {"pids_limit": -1}},
    "more-pids": {"container": {"pids_limit": 5000}},
    "no-pids": {"container": {"pids_limit": 0}},
    "annotations": {"container": {"annotations": {"run.oci.keep_original_groups": "1"}}},
    "shares": {"container": {"cpu_shares": 2048}},
    "exclusive": {"exclusive": ["gpu"]},
}


@pytest.mark.slow
@pytest.mark.parametrize("spec", MORE.values(), ids=MORE)
def test_what_a_manager_writes_has_no_right_that_it_lacks(robot, spec):
    refusal(robot, spec)
    put(robot, {"container": {"pids_limit": 100, "cap_drop": ["ALL"], "cpus": 0.5, "read_only": True}})


@pytest.mark.slow
def test_a_manager_gives_what_it_has_and_what_a_person_gave_to_the_service(robot):
    put(robot, {**KEPT, "priority": 9}, "lab-kept", base_of(robot, "lab-kept"))
    more = {**KEPT["container"], "annotations": {"a": "b", "c": "d"}}
    refusal(robot, {**KEPT, "container": more}, "lab-kept", base_of(robot, "lab-kept"))
    put(robot, {"profile": "lab-bare"}, "lab-bare")
    boss = {**BOSS, "profile": "ros2", "exclusive": ["gpu"], "container": {"user": "1000", "pids_limit": 50}}
    robot.declare({**TREE, "boss": boss}, profiles=PROFILES)
    robot.settle()
    own = {"user": "1000", "pids_limit": 50}
    put(robot, {"profile": "ros2", "exclusive": ["gpu"], "container": own}, "lab-y")
    for container in ({**own, "user": "1001"}, {**own, "pids_limit": 51}, {"pids_limit": 50}):
        refusal(robot, {"container": container}, "lab-z")


@pytest.mark.slow
def test_a_probe_of_what_a_manager_writes_reaches_no_network_that_it_lacks(robot):
    probe = {"ready": {"http": "http://10.0.0.1/"}}
    put(robot, probe)
    robot.declare({**TREE, "boss": {**BOSS, "container": {"network_mode": "none"}}}, profiles=PROFILES)
    robot.settle()
    own = {"profile": "lab-off"}
    robot.declare(
        {**TREE, "boss": {**BOSS, "container": {"network_mode": "none"}}},
        profiles={**PROFILES, "lab-off": {"container": {"network_mode": "none"}}},
    )
    robot.settle()
    assert "network" in refusal(robot, {}, "lab-z")
    assert "probe" in refusal(robot, {**own, **probe}, "lab-z")
    put(robot, own, "lab-z")
