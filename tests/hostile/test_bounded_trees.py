"""However a tree is written, reading it takes little time and memory; what is too much is an error with its place."""

from __future__ import annotations

import json
import time
import tracemalloc

import pytest
import yaml
from robots import write_tree

from rorg.core.masking import masked
from rorg.manifest.load import Loaded, load
from rorg.manifest.template import MOST_FILLED

SIZE = 126 << 10
SECONDS = 5.0
"""Of CPU for one tree on a loaded computer; all of these take less than half a second on an idle one."""
UNITS = {
    "node": "<node ",
    "name": "<node name=",
    "comment": "<!--",
    "underscores": "_",
    "commands": "_cmdx",
    "word": "a_",
    "loop": "until nc ",
    "colons": "a:",
    "slashes": "/a",
    "quotes": "'a \"b ",
    "exec": ";exec",
    "secret": "password",
    "options": "curl a ",
    "spaces": " ",
    "sim": "use_sim_time ",
}


def loaded(root) -> Loaded:
    began = time.process_time()
    found = load(root)
    assert time.process_time() - began < SECONDS
    return found


def errors(root) -> list[str]:
    return [str(d).replace(f"{root}/", "") for d in loaded(root).errors]


@pytest.mark.slow
@pytest.mark.parametrize("unit", UNITS.values(), ids=UNITS)
def test_no_text_of_the_tree_takes_long(tmp_path, unit):
    text = (unit * SIZE)[:SIZE]
    container = {"volumes": ["./files:/files:ro"], "environment": {"TEXT": text}}
    services = {
        "script": {"command": ["sh", "-c", f"{text} cmd use_sim_time"], "idle": {"action": "pause"}},
        "files": {"command": ["roslaunch", "/files/a.launch"], "container": container},
    }
    write_tree(tmp_path, services)
    (tmp_path / "services/files").mkdir()
    (tmp_path / "services/files/a.launch").write_text(f"{text} cmd")
    assert loaded(tmp_path).catalog is not None


@pytest.mark.parametrize("unit", UNITS.values(), ids=UNITS)
def test_no_text_takes_long_to_be_shown(unit):
    began = time.process_time()
    masked("command", ["sh", "-c", (unit * SIZE)[:SIZE]])
    assert time.process_time() - began < SECONDS


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("curl a -u me:pin https://x -u you:pin", "curl a -u *** https://x -u you:pin"),
        ("curl a; echo -u b; curl -u 'a;b' c", "curl a; echo -u b; curl -u *** c"),
        ("/usr/bin/mysql -phunter x; redis-cli -a pin", "/usr/bin/mysql -p*** x; redis-cli -a ***"),
        ("sshpass -p pin ssh -p 22 robot", "sshpass -p *** ssh -p 22 robot"),
        ("my_password_of=a token: b --api-key c", "my_password_of=*** token: *** --api-key ***"),
        ("passwordpassword secret", "passwordpassword secret"),
        ("x.token='a b' y", "x.token=*** y"),
        ("curl -u -u x", "curl -u *** x"),
    ],
)
def test_secrets_are_masked_as_before(text, shown):
    assert masked("command", text) == shown


def doubling(count: int) -> str:
    return "A0=xxxxxxxx\n" + "".join(f"A{n}=${{A{n - 1}}}${{A{n - 1}}}\n" for n in range(1, count + 1))


def peak(root) -> tuple[list[str], int]:
    tracemalloc.start()
    try:
        found = errors(root)
        return found, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_variables_that_double_are_an_error_with_their_place(tmp_path):
    write_tree(tmp_path, {"a": {}})
    (tmp_path / "robot.env").write_text(doubling(28))
    found, most = peak(tmp_path)
    assert f"robot.env:16:5: error: variables put more than {MOST_FILLED} characters into this file" in found[0]
    assert most < 64 << 20


def test_a_manifest_that_many_variables_fill_is_an_error_with_its_place(tmp_path):
    write_tree(tmp_path, {"a": {"command": ["echo", *("${A12}${A12:-}" for _ in range(900))]}})
    (tmp_path / "robot.env").write_text(doubling(12))
    found, most = peak(tmp_path)
    assert found[0].startswith("services/a.yaml:")
    assert "variables put more than" in found[0]
    assert most < 64 << 20


def test_a_file_of_variables_that_double_is_an_error_with_its_place(tmp_path):
    write_tree(tmp_path, {"a": {"container": {"env_file": ["a.env"]}}})
    (tmp_path / "services/a.env").write_text(doubling(28))
    found, most = peak(tmp_path)
    assert "services/a.env:16:5: error: variables put more than" in found[0]
    assert most < 64 << 20


def test_a_text_of_many_variables_is_no_problem(tmp_path):
    write_tree(tmp_path, {"arm": {"command": ["echo", "${A}" * 20000, *["${A}"] * 500]}})
    (tmp_path / "robot.env").write_text("A=12345\n")
    assert errors(tmp_path) == []


LISTS = {
    "needs": {"needs": [f"unknown-service-{n}" for n in range(38_000)]},
    "requests": {"may_request": [f"unknown-service-{n}" for n in range(900)]},
    "mapping": {"container": {"environment": {f"X{n}": "1" for n in range(38_000)}}},
    "unknown": {"container": {f"unknown{n}": "1" for n in range(900)}},
    "words": {"command": ["echo"] * 38_000},
    "ports": {"container": {"network_mode": "bridge", "ports": [f"{n}:80" for n in range(1000, 1900)]}},
    "volumes": {"container": {"volumes": [f"maps{n}:/{n}" for n in range(900)]}},
    "conflicts": {"conflicts": [f"service-{n}x" for n in range(900)]},
    "unset": {"unset_environment": [f"unknown{n}" for n in range(900)]},
    "secrets": {"secrets": [f"unknown{n}" for n in range(900)]},
}


@pytest.mark.slow
@pytest.mark.parametrize("spec", LISTS.values(), ids=LISTS)
def test_no_list_takes_long(tmp_path, spec):
    volumes = {f"map{n}": {} for n in range(50)}
    write_tree(tmp_path, {"a": spec, **{f"service-{n}": {} for n in range(100)}}, volumes=volumes)
    found = errors(tmp_path)
    assert len(found) <= 201
    if any(len(v) > 1000 for v in (*spec.values(), *spec.get("container", {}).values())):
        assert found[0].startswith("services/a.yaml:")
        assert "more than" in found[0]


def test_mistakes_that_are_not_told_are_counted(tmp_path):
    write_tree(tmp_path, {f"s{n}": {"needs": [f"unknown{m}" for m in range(100)]} for n in range(5)})
    found = errors(tmp_path)
    assert len(found) == 201
    assert "300 more mistakes" in found[-1] or any("300 more mistakes" in one for one in found)


def test_comments_that_allow_take_no_time(tmp_path):
    write_tree(tmp_path, {"a": {}})
    path = tmp_path / "services/a.yaml"
    path.write_text("# rorg: allow latest-image: why\n" * 8000 + path.read_text())
    loaded(tmp_path)


@pytest.mark.slow
def test_one_manifest_through_the_api_costs_little(tmp_path):
    from rorg.api.manifest_texts import check_tree
    from rorg.errors import Invalid

    write_tree(tmp_path, {"a": {}})
    spec = {"image": "x", "needs": [f"unknown{n}" for n in range(38_000)]}
    body = {"apiVersion": "rorg/v1", "kind": "Service", "metadata": {"name": "b"}, "spec": spec}
    began = time.process_time()
    with pytest.raises(Invalid, match=r"services/b\.yaml:1:\d+: error: .*more than 1000"):
        check_tree(tmp_path, tmp_path / "services/b.yaml", json.dumps(body), engine="", what="put it")
    assert time.process_time() - began < SECONDS
    assert yaml.safe_load(json.dumps(body)) == body
