"""Keys of Compose, Kubernetes and systemd lead to the place where rorg has them: each remedy is applied, and the result
is a valid manifest."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from rorg.manifest.documents import read_source
from rorg.manifest.field_paths import find
from rorg.manifest.hints import HERE, KINDS, WORDS
from rorg.manifest.models import SPECS
from rorg.manifest.probes import FORMS

BASE = {
    "Service": {"image": "robot"},
    "Profile": {"restart": "always"},
    "Image": {"context": "."},
    "Group": {"services": ["nav"]},
}


def told(kind: str, path: tuple[str, ...], key: str, value: object = "x", **more: object) -> str:
    """The remedy for an unknown key at a path."""
    manifest = _manifest(kind, more)
    at = manifest
    for part in path:
        at = at.setdefault(part, {})
    at[key] = value
    _, found = _read(manifest)
    (one,) = [d for d in found if d.message == f"unknown key '{key}'"]
    return one.remedy


def _manifest(kind: str, more: dict | None = None) -> dict:
    return {
        "apiVersion": "rorg/v1",
        "kind": kind,
        "metadata": {"name": "nav"},
        "spec": {**BASE.get(kind, {}), **(more or {})},
    }


def _read(manifest: dict):
    return read_source(yaml.safe_dump(manifest), Path("nav.yaml"), "nav.yaml", Path("."))


def applied(kind: str, path: tuple[str, ...], remedy: str) -> list[str] | None:
    """The mistakes of a manifest after a key was renamed or moved as a remedy says, with the example of the remedy or
    of the field; None if the remedy is an instruction in words."""
    if remedy.startswith(("'", *(f"{name}:" for name in _names(kind, path)))):
        place, example = (*path, remedy.strip("'").partition(":")[0]), remedy.strip("'").partition(": ")[2]
    elif remedy.startswith(("spec.", "metadata.")) and " " not in remedy.partition(":")[0]:
        place, example = tuple(remedy.partition(":")[0].split(".")), remedy.partition(": ")[2]
    else:
        return None
    manifest = _manifest(kind)
    at = manifest
    for part in place[:-1]:
        at = at.setdefault(part, {})
    field = find(f"{kind.lower()}.{'.'.join(place)}").field
    at[place[-1]] = yaml.safe_load(example) if example else VALUES.get(place[-1], field.example)
    if place[-1] == "import":
        del manifest["spec"]["context"]
    if len(place) == 3 and place[1] in PROBES and place[2] not in FORMS:
        at["file"] = "/tmp/ready"
    _, found = _read(manifest)
    return [str(d) for d in found]


def _names(kind: str, path: tuple[str, ...]) -> list[str]:
    place = find(".".join((kind.lower(), *path))) if path else None
    return [n for n in place.model.model_fields] if place and place.model else []


VALUES = {"type": "container"}
PROBES = ("ready", "live", "interlock")
PLACES = [
    ("Service", ()),
    ("Service", ("spec",)),
    ("Service", ("spec", "container")),
    ("Service", ("spec", "resources")),
    ("Service", ("spec", "ready")),
    ("Service", ("spec", "live")),
    ("Service", ("spec", "interlock")),
    ("Service", ("spec", "idle")),
    ("Service", ("metadata",)),
    ("Profile", ("spec",)),
    ("Profile", ("spec", "container")),
    ("Image", ("spec",)),
    ("Group", ("spec",)),
    ("Policy", ("spec",)),
]
ALL = sorted({*WORDS, *(word for words in HERE.values() for word in words), *SPECS["Service"].model_fields})


@pytest.mark.parametrize(("kind", "path"), PLACES, ids=lambda p: ".".join(p) if isinstance(p, tuple) else p)
def test_each_remedy_is_valid_where_it_is_given(kind, path):
    count = 0
    for word in ALL:
        manifest = _manifest(kind)
        at = manifest
        for part in path:
            at = at.setdefault(part, {})
        at[word] = "x"
        found = [d for d in _read(manifest)[1] if d.message == f"unknown key '{word}'"]
        for one in found:
            mistakes = applied(kind, path, one.remedy)
            if mistakes is not None:
                count += 1
                assert mistakes == [], (word, one.remedy)
    assert count > 0


@pytest.mark.parametrize(
    ("path", "key", "remedy"),
    [
        (("spec",), "environment", "spec.container.environment"),
        (("spec",), "env", "spec.container.environment"),
        (("spec",), "ports", "spec.container.ports"),
        (("spec",), "volumes", "spec.container.volumes"),
        (("spec",), "devices", "spec.container.devices"),
        (("spec",), "requires", "'needs'"),
        (("spec",), "depends_on", "'needs'"),
        (("spec",), "dependencies", "'needs'"),
        (("spec",), "cwd", "spec.container.working_dir"),
        (("spec",), "args", "'command'"),
        (("spec",), "envFrom", "spec.container.env_file: [./FILE.env]"),
        (("spec",), "livenessProbe", "live: {http: http://localhost:8080/health}"),
        (("spec",), "readinessProbe", "ready: {http: http://localhost:8080/health}"),
        (("spec",), "ExecStart", "'command'"),
        (("spec",), "WorkingDirectory", "spec.container.working_dir"),
        (("spec",), "After", "'needs'"),
        (("spec",), "Requires", "'needs'"),
        (("spec",), "WantedBy", "always_on: true"),
        (("spec",), "User", "spec.container.user"),
        (("spec",), "replicas", "one Service for each copy"),
        (("spec",), "healthcheck", "spec.container.healthcheck"),
        (("spec",), "privileged", "spec.container.privileged"),
        (("spec",), "alwaysOn", "'always_on'"),
        (("spec",), "containers", "one Service for each container"),
        (("spec", "container"), "depends_on", "spec.needs"),
        (("spec", "container"), "image", "spec.image"),
        (("spec", "container"), "cwd", "'working_dir'"),
        (("spec", "container"), "memory", "'mem_limit'"),
        (("spec", "resources"), "limits", "cpus and mem_limit in spec.container"),
        (("spec", "resources"), "requests", "spec.resources: {cpu: 0.5, memory: 256Mi}"),
        (("spec", "ready"), "httpGet", "http: http://localhost:8080/health"),
        (("spec", "ready"), "initialDelaySeconds", "'delay'"),
        (("spec", "ready"), "periodSeconds", "'interval'"),
        (("metadata",), "annotations", "'labels'"),
        ((), "image", "spec.image"),
        ((), "name", "metadata.name"),
        (("spec",), "timeout", ""),
    ],
    ids=str,
)
def test_words_of_other_tools_have_one_place(path, key, remedy):
    assert told("Service", path, key) == remedy


def test_a_need_has_no_condition():
    needs = [{"service": "roscore", "condition": "service_healthy"}]
    _, (found,) = _read(_manifest("Service", {"needs": needs}))
    assert (found.message, found.remedy.startswith("to leave it out")) == ("unknown key 'condition'", True)


def test_a_profile_gets_only_what_a_profile_has():
    assert told("Profile", ("spec",), "depends_on") == "'needs'"
    assert told("Profile", ("spec",), "environment") == "spec.container.environment"
    assert "always_on" not in told("Profile", ("spec",), "WantedBy")


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_kinds_of_kubernetes_are_known(kind):
    _, found = _read(_manifest(kind))
    assert KINDS[kind] in [d.remedy for d in found if d.message == f"unknown kind '{kind}'"]


@pytest.mark.parametrize(("text", "remedy"), [("yes", "true"), ("On", "true"), ("no", "false"), ("off", "false")])
def test_words_of_yaml_1_1_are_no_booleans(text, remedy):
    _, (found,) = _read(_manifest("Service", {"always_on": text}))
    assert str(found).endswith(f"error: spec.always_on: '{text}' is a text, not true or false; try {remedy}")


@pytest.mark.parametrize(
    ("field", "value", "about", "remedy"),
    [
        ("spec.needs", "x", "a text, not a list", "[x]"),
        ("spec.mounts", "./a, b:/b", "a text, not a list", '["./a, b:/b"]'),
        ("spec.container.cap_add", "ALL", "a text, not a list", "[ALL]"),
        ("spec.needs", "true", "a boolean, not a list", '["true"]'),
        ("spec.command", "true", "a boolean, not a text", "quotes around it"),
        ("spec.profile", "12", "a number, not a text", "quotes around it"),
        ("spec.ready.exec", "false", "a boolean, not a text", "quotes around it"),
        ("spec.image", "12", "a number, not a text", "quotes around it"),
        ("spec.image", "1.10", "a number, not a text", "quotes around it"),
        ("spec.container.hostname", "true", "a boolean, not a text", "quotes around it"),
        ("metadata.description", "5", "a number, not a text", "quotes around it"),
        ("spec.command", "[a, 5]", "a number, not a text", "quotes around it"),
        ("spec.image", "[x]", "a list, not a text", ""),
        ("spec.needs", "{x: y}", "a mapping, not a list", ""),
        ("spec.needs", "", "a list is missing", ""),
    ],
)
def test_a_value_of_another_type_is_told_how_to_be_written(field, value, about, remedy):
    first, *path = field.split(".")
    manifest = _manifest("Service")
    at = manifest[first]
    for part in path[:-1]:
        at = at.setdefault(part, {})
    at[path[-1]] = "VALUE"

    def found(written: str) -> list[str]:
        text = yaml.safe_dump(manifest).replace("VALUE", written)
        return [f"{d.message}; {d.remedy}" for d in read_source(text, Path("nav.yaml"), "nav.yaml", Path("."))[1]]

    (one,) = found(value)
    assert one.startswith(field)
    assert one.endswith(f"{about}; {remedy}")
    if remedy:
        assert found(remedy if remedy.startswith("[") else f"'{value}'" if value[0] != "[" else "[a, '5']") == []


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("spec:\n\timage: x\n", "nav.yaml:2:1"),
        ("spec:\n  image: x\n\tcommand: y\n", "nav.yaml:3:1"),
        ("spec:\n  container:\n  \tuser: x\n", "nav.yaml:3:3"),
    ],
)
def test_a_tab_is_named(text, place):
    _, (found,) = read_source(text, Path("nav.yaml"), "nav.yaml", Path("."))
    assert str(found) == f"{place}: error: not valid YAML: this line is indented with a tab; try spaces"
