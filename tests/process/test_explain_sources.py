"""`rorg explain` names the source of each value: the robot, a profile, or a default."""

from __future__ import annotations

import json

import commands
import pytest
from built_in_profiles import BUILT_IN, GIVES
from common import ROOT
from robots import write_tree

from rorg.manifest.load import load_or_raise

SERVICES = sorted(load_or_raise(ROOT / "manifests").services.keys() - {"developer"})


@pytest.mark.slow
@pytest.mark.parametrize("name", SERVICES)
def test_explain_tells_the_source_of_every_value(name):
    found = json.loads(commands.rorg("explain", name, str(ROOT / "manifests"), "-o", "json", code=0).stdout)
    assert found["service"] == name
    assert found["values"]
    for value in found["values"]:
        source = value["source"]
        assert source["kind"] in ("manifest", "profile", "policy", "env_file", "default"), value
        if source["kind"] != "default":
            assert source["file"], value
            assert source["line"] > 0, value
        assert (source["kind"] == "profile") == ("name" in source), value
        assert not (source["kind"] == "default" and value["field"].startswith(("container", "needs", "image"))), value


@pytest.mark.parametrize("profile", BUILT_IN)
def test_explain_names_the_source_of_each_value(tmp_path, profile):
    specs = {"nav": {"image": "img", "profile": profile}, "roscore": {"image": "img", "command": "roscore"}}
    write_tree(tmp_path / "manifests", specs)
    found = json.loads(commands.rorg("explain", "nav", "-o", "json", cwd=tmp_path).stdout)
    kinds = {v["source"]["kind"] for v in found["values"]}
    assert kinds <= {"manifest", "profile", "default"}
    assert all("file" in v["source"] for v in found["values"] if v["source"]["kind"] != "default")
    options = {v["field"]: v for v in found["values"] if v["field"].startswith("container.")}
    if not GIVES[profile]:
        assert {v["source"]["kind"] for v in options.values()} <= {"manifest"}, "not even what common gives"
        return
    field, value = GIVES[profile]
    assert options[field]["value"] == value
    assert (options[field]["source"]["name"], options[field]["source"]["file"]) == (
        profile,
        f"<built in>/{profile}.yaml",
    )
    assert options["container.init"]["source"]["name"] == "common"
