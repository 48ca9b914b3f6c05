"""Containers that would be the same are not replaced: normal forms of declared options."""

from __future__ import annotations

import json

from common import BASE_IMAGE
from hypothesis import given, settings
from hypothesis import strategies as st
from option_spellings import HEAD, SPELLINGS, TEXT
from robots import write_tree

from rorg.core.desired import desire
from rorg.core.diff import normal, normal_fields
from rorg.manifest.container import ContainerOptions
from rorg.manifest.load import load_or_raise

JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-5, 5)
    | st.floats(allow_nan=False)
    | st.sampled_from(
        [
            "",
            "rw",
            "a:/b",
            "/a:/b:ro,rw",
            "80:80/tcp",
            "8080-8089:80",
            "/dev/null:/dev/x:mr",
            "on-failure:0",
            "CAP_KILL",
            "a:1",
            "label:disable",
            "2",
            "/run:size=1m,mode=700",
        ]
    )
    | st.text(":/=-.,az09", max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["type", "target", "a"]), inner),
    max_leaves=8,
)
OPTIONS = st.sampled_from([*ContainerOptions.model_fields, "command", "environment.A", "image"])


def accepted_specs(folder) -> dict[str, dict]:
    (folder / "services").mkdir(parents=True)
    (folder / "services/seccomp.json").write_text("{}")
    for spelling in (s for s in SPELLINGS if s.expected is not None):
        head = HEAD.replace("NAME", spelling.name).replace("PROFILE", "profile: plain")
        (folder / f"services/{spelling.name}.yaml").write_text(f"{head}{TEXT}{spelling.text}}}\n")
    return {s.name: s.spec for s in load_or_raise(folder).services.values() if s.spec}


@given(OPTIONS, JSON)
@settings(max_examples=400, deadline=None)
def test_a_normal_form_is_its_own_normal_form(option, value):
    once = normal(option, value)
    assert normal(option, once) == once
    assert normal(option, json.loads(json.dumps(once))) == once


SETS = st.sampled_from(
    [
        "cap_add",
        "cap_drop",
        "volumes",
        "security_opt",
        "devices",
        "group_add",
        "ports",
        "expose",
        "tmpfs",
        "device_cgroup_rules",
        "links",
    ]
)
ITEMS = st.lists(
    st.sampled_from(
        [
            "KILL",
            "CAP_KILL",
            "a1:/b",
            "a1:/b:rw",
            "/c:/d:ro",
            "/dev/a",
            "/dev/a:/dev/a:mrw",
            "80",
            "8080:80/udp",
            "/run:size=1m",
        ]
    )
)


@given(st.randoms(), SETS, ITEMS)
def test_order_and_repetition_mean_nothing_in_sets(random, option, values):
    other = values + values[:2]
    random.shuffle(other)
    assert normal(option, values) == normal(option, other)


def test_what_is_accepted_has_a_normal_form_that_tells_it_apart(tmp_path):
    """Two spellings that make different containers never look the same."""
    specs = accepted_specs(tmp_path)
    told: dict[str, list] = {}
    for spelling in (s for s in SPELLINGS if s.expected is not None):
        fields = normal_fields(json.loads(json.dumps(specs[spelling.name])))
        assert normal_fields(fields) == fields
        told.setdefault(json.dumps(fields, sort_keys=True), []).append(spelling)
    undeclared = json.dumps(normal_fields({"image": BASE_IMAGE, "command": ["true"]}), sort_keys=True)
    assert {s.text for s in told.pop(undeclared)} == BY_ITSELF
    groups = [group for group in told.values() if len({json.dumps(s.expected) for s in group}) > 1]
    assert {frozenset(s.text for s in group) for group in groups} == ONE_MEANING


def test_the_fingerprint_of_a_tree_is_of_all_that_it_declares_and_of_nothing_else(tmp_path):
    def found(place: str) -> str:
        write_tree(tmp_path, {"arm": {"container": {"environment": {"where": place, "origins": "here"}}}})
        return load_or_raise(tmp_path).fingerprint

    first, other = found("left"), found("right")
    assert first != other
    assert found("left") == first
    path = tmp_path / "services/arm.yaml"
    path.write_text("# a line more\n" + path.read_text())
    assert load_or_raise(tmp_path).fingerprint == first


def test_the_digest_of_a_declaration_is_what_it_was(tmp_path):
    """A new version of rorg recreates nothing by itself. These digests were made by the first version."""
    spec = {
        "image": "arm:1",
        "command": "run --fast",
        "profile": "ros1",
        "container": {
            "cap_add": ["SYS_NICE"],
            "volumes": ["maps:/maps:ro"],
            "ports": [],
            "environment": {"A": 5},
            "cpus": 0.5,
            "ulimits": {"nofile": 1024},
            "logging": {"driver": "local"},
            "tmpfs": "/run",
            "mem_limit": "64Mi",
            "healthcheck": {"test": "ls /", "interval": "2s"},
            "extra_hosts": {"base": "10.0.0.1"},
            "restart": "no",
        },
        "driver": {"devices": ["/dev/null:/dev/arm"], "groups": ["dialout", 44], "realtime": True},
    }
    write_tree(tmp_path, {"arm": spec, "roscore": {"image": "ros", "command": ["x"]}})
    assert desire(load_or_raise(tmp_path)).digests == DIGESTS


BY_ITSELF = {
    "cap_add: []",
    "isolation: default",
    "mem_limit: 0",
    "network_mode: bridge",
    "network_mode: default",
    "oom_kill_disable: false",
    "pids_limit: -1",
    "pids_limit: 0",
    "privileged: false",
    "restart: no",
    "shm_size: 0",
}
"""What makes the container that is made where nothing is declared."""
ONE_MEANING = {
    frozenset(["cap_add: [SYS_NICE]", "cap_add: [sys_nice]"]),
    frozenset(["security_opt: [no-new-privileges]", "security_opt: ['no-new-privileges:true']"]),
    frozenset(["security_opt: [seccomp=unconfined]", "security_opt: ['seccomp:unconfined']"]),
    frozenset(["stop_signal: SIGINT", "stop_signal: INT", "stop_signal: int", "stop_signal: 2"]),
}
"""Of these the table expects different words of the engine, and they mean one thing."""
DIGESTS = {"arm": "v1:32e4b25a316b16c5fc65bdedc3abca3b", "roscore": "v1:e408551fcf86db2726798873062dc8de"}
