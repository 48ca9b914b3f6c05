"""`rorg explain`: fields from the models alone, services with the source of every value."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import commands
import pytest
import yaml
from common import ROOT

from rorg.cli.explain import _page
from rorg.manifest.effective import effective
from rorg.manifest.field_paths import all_paths, find, nearest_path
from rorg.manifest.load import load, load_or_raise
from rorg.manifest.models import EXAMPLES, FOLDERS, SPECS

FOUND = {
    "service": "service",
    "Service": "service",
    "policies": "policy",
    "service.spec": "service.spec",
    "service.spec.idle.linger": "service.spec.idle.linger",
    "service.idle.linger": "service.spec.idle.linger",
    "services.idle": "service.spec.idle",
    "spec.ready": "service.spec.ready",
    "ready.timeout": "service.spec.ready.timeout",
    "spec.pressure.high": "policy.spec.pressure.high",
    "pressure": "policy.spec.pressure",
    "container.devices": "service.spec.container.devices",
    "container.ulimits.nofile.soft": "service.spec.container.ulimits.NAME.soft",
    "container.volumes[0].source": "service.spec.container.volumes.source",
    "profile.container.env_file": "profile.spec.container.env_file",
    "metadata.labels": "service.metadata.labels",
    "group.metadata.name": "group.metadata.name",
    "image.import": "image.spec.import",
    "apiVersion": "service.apiVersion",
}
NEAR = {
    "service.spec.idel": "service.spec.idle",
    "service.idle.lingr": "service.spec.idle.linger",
    "linger": "service.spec.idle.linger",
    "spec.redy": "service.spec.ready",
    "container.device": "service.spec.container.devices",
    "policy.presure": "policy.pressure",
    "mem_limt": "service.spec.container.mem_limit",
    "foo.bar": "",
}


def rorg(*words: str, at: Path, code: int = 0) -> subprocess.CompletedProcess:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("RORG_")}
    done = commands.run(["explain", *words], {**environment, "RORG_STATE_DIR": str(at / "state")}, at)
    assert done.returncode == code, f"exit {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


# -- fields ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("path", "found"), FOUND.items())
def test_a_field_is_found_as_people_name_it(path, found):
    place = find(path)
    assert place
    assert place.path == found


@pytest.mark.parametrize(("path", "near"), NEAR.items())
def test_what_is_no_field_leads_to_the_nearest(path, near):
    assert find(path) is None
    assert nearest_path(path) == near
    assert not near or find(near)


def test_every_field_of_every_kind_has_a_page():
    paths = all_paths()
    assert len(paths) > 350
    for path in paths:
        place = find(path)
        assert place, path
        page = _page(place)
        assert path in page.splitlines()[0]
        assert "\nEXAMPLE\n" in page


def test_each_kind_names_its_folder(tmp_path):
    reference = (ROOT / "docs/reference/manifests.md").read_text()
    for folder, kind in FOLDERS.items():
        assert f"`{folder}/NAME.yaml`" in " ".join(rorg(kind.lower(), at=tmp_path).stdout.split())
        assert f"`{folder}/NAME.yaml`" in reference.partition(f"\n## {kind}\n")[2].partition("\n## ")[0]


@pytest.mark.parametrize("kind", SPECS)
def test_the_example_of_a_kind_is_a_whole_manifest(kind):
    text = _page(find(kind.lower())).partition("EXAMPLE\n")[2].partition("\nFIELDS")[0]
    value = yaml.safe_load(text)
    assert (value["kind"], value["spec"]) == (kind, EXAMPLES[kind])
    SPECS[kind].model_validate(value["spec"])


@pytest.mark.slow
def test_a_field_needs_no_robot(tmp_path):
    page = rorg("service.spec.idle.linger", at=tmp_path).stdout
    assert page.splitlines()[:3] == ["FIELD    service.spec.idle.linger", "TYPE     duration", "DEFAULT  0s"]
    assert "  linger: 20s" in page
    found = json.loads(rorg("spec.ready", "-o", "json", at=tmp_path).stdout)
    assert found["fields"]["timeout"]["default"] == "30s"
    assert list(tmp_path.iterdir()) == [], "nothing is written"
    assert "try service.spec.ready" in rorg("spec.redy", at=tmp_path, code=2).stderr
    assert "no manifests with a service of that name" in rorg("navigation", at=tmp_path, code=2).stderr


# -- services --------------------------------------------------------------------------------------------------

TREE = {
    "services/arm.yaml": """
apiVersion: rorg/v1
kind: Service
metadata: {name: arm}
spec:
  image: robot
  profile: hand
  needs: [base]
  idle: {linger: 20}
  may_request: [base]
  driver: {devices: ["/dev/null:/dev/arm"]}
  mounts: ["./conf:/etc/arm"]
  container:
    env_file: ["./secret.env"]
    environment: {LEVEL: debug, BOTH: mine}
    ulimits: {nofile: 65536}
    volumes: ["./conf:/root/conf:ro"]
    mem_limit: 512Mi
""",
    "services/base.yaml": """
apiVersion: rorg/v1
kind: Service
metadata: {name: base}
spec: {type: meta}
""",
    "profiles/hand.yaml": """
apiVersion: rorg/v1
kind: Profile
metadata: {name: hand}
spec:
  extends: [ros2]
  idle: {action: pause, linger: 5s}
  ready: {tcp: 9090}
  container:
    environment:
    - TEAM=${service}s
    - LEVEL=info
    pids_limit: 99
""",
    "policies/policy.yaml": """
apiVersion: rorg/v1
kind: Policy
metadata: {name: policy}
spec:
  idle: {min_active: 3s}
  interlock: {file: /run/parked}
""",
    "groups/all.yaml": """
apiVersion: rorg/v1
kind: Group
metadata: {name: all}
spec: {services: [arm]}
""",
    "services/conf/x": "",
    "services/secret.env": "# comment\nTOKEN=hush-hush\nBOTH=hush-hush\n",
}


@pytest.fixture
def tree(tmp_path):
    root = tmp_path / "manifests"
    for name, text in TREE.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text.lstrip())
    return root


def test_every_value_has_its_source(tree):
    found = {v.field: (v.text, v.source.replace(f"{tree}/", "")) for v in effective(tree, "arm")}
    arm, hand = "manifest, services/arm.yaml", "profile hand, profiles/hand.yaml"
    expected = {
        "image": ("robot", f"{arm}:5"),
        "needs[0]": ("base", f"{arm}:7"),
        "idle.action": ("pause", f"{hand}:6"),
        "idle.linger": ("20s", f"{arm}:8"),
        "idle.min_active": ("3s", "policy, policies/policy.yaml:5"),
        "idle.reclaim": ("false", "default"),
        "ready.tcp": ("9090", f"{hand}:7"),
        "ready.timeout": ("30s", "default"),
        "interlock.file": ("/run/parked", "policy, policies/policy.yaml:6"),
        "protected": ("true", "default"),
        "priority": ("50", "default"),
        "container.devices[0]": ("/dev/null:/dev/arm", f"{arm}:10"),
        "container.environment.LEVEL": ("debug", f"{arm}:14"),
        "container.environment.TEAM": ("arms", f"{hand}:10"),
        "container.environment.BOTH": ("mine", f"{arm}:14"),
        "container.environment.TOKEN": ("(not shown)", "env_file ./secret.env, services/arm.yaml:13"),
        "container.ulimits.nofile.soft": ("65536", f"{arm}:15"),
        "container.mem_limit": ("512Mi", f"{arm}:17"),
        "container.pids_limit": ("99", f"{hand}:12"),
        "container.init": ("true", "profile common, <built in>/common.yaml:9"),
        "container.volumes[0]": (f"{tree}/services/conf:/root/conf:ro", f"{arm}:16"),
        "container.volumes[1]": (f"{tree}/services/conf:/etc/arm:ro", f"{arm}:11"),
    }
    assert {field: found.get(field) for field in expected} == expected
    assert found["container.environment.RORG_SOCKET"][1] == f"{arm}:9"
    assert next(v.value for v in effective(tree, "arm") if v.field == "idle.linger") == 20.0


def test_mappings_are_shown_as_people_write_them(tree):
    manifest = tree / "services/leg.yaml"
    spec = {
        "image": "robot",
        "idle": {"action": "pause", "escalate": {"after": "4s", "action": "stop"}},
        "ready": {"all": [{"file": "/x", "interval": "2s"}, {"file": "/y"}]},
        "container": {
            "healthcheck": {"test": ["CMD", "true"], "interval": "5s"},
            "volumes": [{"type": "tmpfs", "target": "/t", "tmpfs": {"size": "1Gi"}}],
        },
    }
    head = {"apiVersion": "rorg/v1", "kind": "Service", "metadata": {"name": "leg"}}
    manifest.write_text(yaml.safe_dump({**head, "spec": spec}))
    found = {v.field: v.text for v in effective(tree, "leg")}
    assert found["idle.escalate"] == "{after: 4s, action: stop}"
    assert found["ready.all"] == "[{file: /x, interval: 2s}, {file: /y}]"
    assert found["container.healthcheck"] == "{test: [CMD, 'true'], interval: 5s}"
    assert found["container.volumes[0]"] == "{type: tmpfs, target: /t, tmpfs: {size: 1Gi}}"
    assert "DEFAULT  [lost, quarantined, failed" in rorg("policy.notify.on", at=tree.parent).stdout


@pytest.mark.slow
def test_what_holds_is_what_the_service_has():
    """Of every service of a whole robot: each value of the container is there once, from who rorg says declares it."""
    root = ROOT / "manifests"
    for name, service in load_or_raise(root).services.items():
        if service.meta:
            continue
        values = effective(root, name)
        for value in values:
            words = value.field.split(".", 2)
            if words[0] != "container":
                continue
            option = words[1].partition("[")[0]
            origins = service.origins.get(".".join([option, *words[2:]]), service.origins.get(option, ""))
            origins = origins or ", ".join(o for path, o in service.origins.items() if path.startswith(f"{option}."))
            said = f"profile {value.name}" if value.kind == "profile" else ""
            assert said in origins, f"{name}: {value.field} is said to come from {value.source}, not {origins}"
            assert said or any(part in origins for part in ("this manifest", "driver", "may_request")), value
        assert {v.field.removeprefix("container.environment.") for v in values} >= set(
            (service.spec or {}).get("environment", {})
        )


@pytest.mark.parametrize("form", ["table", "json", "yaml"])
def test_no_form_shows_what_a_file_of_variables_says(tree, form):
    said = rorg("arm", "-o", form, at=tree.parent).stdout
    assert "TOKEN" in said
    assert "debug" in said
    assert "hush" not in said


@pytest.mark.slow
def test_names_of_services(tree):
    at = tree.parent
    assert "services/arm.yaml" in rorg("services/arm", at=at).stdout
    assert "services/arm.yaml" in rorg("arm", str(tree), at=at).stdout
    assert "try arm" in rorg("amr", at=at, code=2).stderr
    assert "it is a group; try one of arm" in rorg("all", at=at, code=2).stderr
    assert "no such service" in rorg("services/idle", at=at, code=2).stderr
    (tree / "services/base.yaml").write_text("x: [")
    assert "base.yaml:2:1: error" in rorg("arm", at=at, code=2).stderr


def test_a_meta_service_has_no_container(tree):
    assert {v.field for v in effective(tree, "base")} >= {"type", "priority"}
    assert not [v.field for v in effective(tree, "base") if v.field.startswith(("container", "needs", "profile"))]
    assert effective(tree, "nobody") == []
    assert load(tree).catalog


@pytest.mark.parametrize("profile", [["mine", "realtime"], "both"])
def test_what_the_first_of_two_profiles_says_is_not_undone_by_what_the_second_leaves_to_common(tmp_path, profile):
    specs = {
        "services/arm.yaml": ("Service", "arm", {"image": "arm:1", "profile": profile}),
        "profiles/mine.yaml": ("Profile", "mine", {"container": {"stop_grace_period": "20s"}}),
        "profiles/both.yaml": ("Profile", "both", {"extends": ["mine", "realtime"]}),
    }
    for path, (kind, name, spec) in specs.items():
        file = tmp_path / path
        file.parent.mkdir(exist_ok=True)
        manifest = {"apiVersion": "rorg/v1", "kind": kind, "metadata": {"name": name}, "spec": spec}
        file.write_text(yaml.safe_dump(manifest))
    found = {value.field: value for value in effective(tmp_path, "arm")}
    assert found["container.stop_grace_period"].text == "20s"
    assert "mine" in str(found["container.stop_grace_period"].source)
    assert "common" in str(found["container.stop_signal"].source)
    assert "realtime" in str(found["container.ulimits.rtprio.soft"].source)


@pytest.mark.slow
def test_fields_are_explained_while_manifests_have_mistakes(tree):
    arm = tree / "services/arm.yaml"
    arm.write_text(arm.read_text() + "  bogus: 1\n")
    (tree / "services/broken.yaml").write_text("! [")
    assert "linger: 20s" in rorg("idle.linger", at=tree.parent).stdout
    assert "try service.spec.priority" in rorg("priorty", at=tree.parent, code=2).stderr
    assert "try base" in rorg("bas", at=tree.parent, code=2).stderr
    for service in ("arm", "broken", "services/base"):
        assert "unknown key 'bogus'" in rorg(service, at=tree.parent, code=2).stderr
