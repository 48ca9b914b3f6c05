"""What rorg imports is declared, private parts of libraries are bound to versions that have them, and what the image
installs is pinned by its content."""

from __future__ import annotations

import ast
import re
import runpy
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from importlib.metadata import distributions, packages_distributions
from pathlib import Path

import pytest
from common import ROOT
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
DECLARED = {canonicalize_name(r.name): r for r in map(Requirement, PROJECT["project"]["dependencies"])}
PLOTS = {canonicalize_name(Requirement(text).name) for text in PROJECT["project"]["optional-dependencies"]["plots"]}
"""Only imported where a plot is drawn."""
OWN = {"rorg", "rorg_client"}
"""In the wheel of rorg."""
PRIVATE = {
    "docker": "its client's calls for what it has no method for (rorg/engines/docker)",
    "requests": "the response beneath a stream (rorg/engines/docker/exec.py)",
    "urllib3": "the connection beneath a stream (rorg/engines/docker/exec.py)",
    "typer": "the errors, parameters and completions of the click within it (rorg/cli); 0.29 takes 60 ms more",
    "uvicorn": "its protocol and the main loop of its server (rorg/api)",
}
"""Library -> which parts are used that it does not promise to keep."""
CONSTRAINTS, CI = ROOT / "images/rorg/constraints.txt", ROOT / ".ci/constraints.txt"


def imports() -> Iterator[tuple[Path, str]]:
    for path in sorted((ROOT / "rorg").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                yield from ((path, alias.name.partition(".")[0]) for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and not node.level:
                yield path, (node.module or "").partition(".")[0]


@pytest.mark.slow
def test_what_is_imported_is_declared():
    providers = packages_distributions()
    third = {(path, name) for path, name in imports() if name not in OWN | sys.stdlib_module_names}
    assert len({name for _, name in third}) > 10, "is anything found?"
    missing = {
        f"{path.relative_to(ROOT)}: {name}"
        for path, name in third
        if not {canonicalize_name(p) for p in providers.get(name, [name])} & (DECLARED.keys() | PLOTS)
    }
    assert not missing


@pytest.mark.parametrize("name", sorted(PRIVATE))
def test_private_parts_are_used_of_versions_that_have_them(name):
    operators = {specifier.operator for specifier in DECLARED[name].specifier}
    assert operators == {">=", "<"}, f"{PRIVATE[name]} may change"


def pinned() -> dict[str, tuple[str, list[str]]]:
    """Name -> version and hashes, of the constraints file."""
    found = {}
    for entry in CONSTRAINTS.read_text().replace("\\\n", " ").splitlines():
        words = entry.split("#")[0].split()
        if words:
            name, _, version = words[0].partition("==")
            found[canonicalize_name(name)] = (version, words[1:])
    return found


def test_what_is_pinned_is_pinned_by_content_and_nothing_else_is_said():
    for name, (version, hashes) in pinned().items():
        assert re.fullmatch(r"\d[\w.+!]*", version), name
        assert hashes, name
        assert all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", text) for text in hashes), name


def test_pins_are_within_the_bounds():
    pins = pinned()
    build = [Requirement(text) for text in PROJECT["build-system"]["requires"]]
    for requirement in (*DECLARED.values(), *build):
        name = canonicalize_name(requirement.name)
        assert name in pins, f"{requirement.name} is not pinned; try `make constraints`"
        assert requirement.specifier.contains(pins[name][0]), f"{requirement}; try `make constraints`"


def test_ci_tests_with_releases_within_the_bounds_and_with_those_of_the_image():
    pins = dict(line.split("==") for line in CI.read_text().splitlines() if not line.startswith("#"))
    group = runpy.run_path(str(ROOT / ".ci/dependencies.py"))["group"]
    for requirement in (*DECLARED.values(), *map(Requirement, group("dev"))):
        found = pins.get(canonicalize_name(requirement.name))
        assert found, f"{requirement.name} is not pinned; try `make constraints`"
        assert requirement.specifier.contains(found), f"{requirement}; try `make constraints`"
    different = {name for name, (version, _) in pinned().items() if pins.get(name, version) != version}
    assert not different, "the image is made of others; try `make constraints`"


def test_what_pinned_packages_need_is_pinned():
    """As those say that are installed here: of the same version, what is pinned needs the same."""
    pins, here = pinned(), {canonicalize_name(d.name): d for d in distributions()}
    same = [name for name, (version, _) in pins.items() if name in here and here[name].version == version]
    assert same, "nothing is installed here as it is pinned; try `make constraints`"
    for name in same:
        for requirement in map(Requirement, here[name].requires or ()):
            if not requirement.marker or requirement.marker.evaluate({"extra": ""}):
                needed = canonicalize_name(requirement.name)
                assert needed in pins, f"{name} needs {requirement}; try `make constraints`"
                assert requirement.specifier.contains(pins[needed][0]), f"{name} needs {requirement}"


@pytest.mark.slow
@pytest.mark.parametrize(("minor", "missing"), [(11, ""), (12, "thing==1.0")])
def test_a_release_without_a_wheel_for_arm64_is_named(minor, missing, tmp_path, monkeypatch):
    """pip itself asks, in a folder in place of the package index."""
    with zipfile.ZipFile(tmp_path / "thing-1.0-cp311-cp311-manylinux_2_17_aarch64.whl", "w") as wheel:
        wheel.writestr("thing-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: thing\nVersion: 1.0\n")
        wheel.writestr("thing-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\n")
        wheel.writestr("thing-1.0.dist-info/RECORD", "")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    versions = runpy.run_path(str(ROOT / ".ci/versions"))
    assert versions["missing_wheel"](sys.executable, minor, ["thing==1.0"]) == missing
    assert {f"{name}=={version}" for name, (version, _) in pinned().items()} == set(versions["pinned"]())
