"""Trees with mistakes that few think of: each is told at its place, by the API too, also after a restart of rorg; what
runs goes on, and all is well once the tree is mended."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest
from robots import RealRobot, write_tree

from rorg.core.desired import desire
from rorg.daemon.tree import Tree
from rorg.manifest.documents import UNEXPECTED
from rorg.manifest.load import load
from rorg.model.diagnostics import Where

NUMBER = "9" * 400
LONG = "a" * 5000
SPEC = {
    "a key that is a list": "? [a, b]\n  : c",
    "a key that is a mapping": "container: {environment: {{a: b}: c}}",
    "an infinity": "resources: {cpu: .inf}",
    "a number that is infinite": "resources: {cpu: 1e999}",
    "no number": "resources: {cpu: .nan}",
    "400 digits": f"container: {{shm_size: {NUMBER}}}",
    "400 digits with a unit": f"resources: {{memory: {NUMBER}Gi}}",
    "400 digits of time": f"idle: {{linger: {NUMBER}d}}",
    "5000 digits": f"priority: {'9' * 5000}",
    "a NUL character": 'command: ["a\\0b"]',
    "a NUL character in a path": 'mounts: ["./a\\0b:/x"]',
    "a path that is too long": f"mounts: ['./{LONG}:/x']",
    "an env_file with a name that is too long": f"container: {{env_file: [{LONG}]}}",
    "parentheses that never close": f"ready: {{log: '{'(' * 5000}'}}",
    "an env_file that is not UTF-8": "container: {env_file: [not-utf-8]}",
    "an env_file with a NUL character": "container: {env_file: [nul]}",
    "a mount that links to itself": "mounts: ['./loop:/x']",
    "a seccomp profile without end": "container: {security_opt: ['seccomp=nested']}",
    "an address without end": "ready: {http: 'http://[::1'}",
    "nested without end": "command: " + "[" * 20000,
}
"""What stands below `spec`."""
FINE = {
    "a volume with a name that is too long": f"container: {{volumes: ['./{LONG}:/x:ro']}}",
    "a volume that links to itself": "container: {volumes: ['./loop/x:/y:ro']}",
    "a home of nobody": "container: {volumes: [{type: bind, source: '~nobody-of-that-name/x', target: /y}]}",
    "parentheses in parentheses": f"ready: {{log: '{'(' * 900}a{')' * 900}'}}",
}
"""What only the engine can tell."""


def write(root: Path, spec: str, name: str = "odd") -> Path:
    """A service of that spec, and all that one names."""
    folder = root / "services"
    (folder / "not-utf-8").write_bytes(b"A=\xff\xfe\n")
    (folder / "nul").write_bytes(b"A=b\0c\n")
    (folder / "nested").write_text("[" * 100_000)
    if not (folder / "loop").is_symlink():
        (folder / "loop").symlink_to("loop")
    path = folder / f"{name}.yaml"
    path.write_text(f"apiVersion: rorg/v1\nkind: Service\nmetadata: {{name: {name}}}\nspec:\n  image: x\n  {spec}\n")
    return path


@pytest.mark.parametrize("spec", SPEC.values(), ids=SPEC)
def test_it_is_told_once_at_its_place(tmp_path, spec):
    path = write(write_tree(tmp_path, {"camera": {}}), spec)
    began = time.process_time()
    found = load(tmp_path)
    assert time.process_time() - began < 1.0
    assert [d.where.file for d in found.diagnostics] == [str(path)], found.diagnostics
    assert all(d.where.line > 4 and UNEXPECTED not in d.message for d in found.errors), found.errors


@pytest.mark.parametrize("spec", FINE.values(), ids=FINE)
def test_what_a_manifest_may_say_is_read(tmp_path, spec):
    write(write_tree(tmp_path, {"camera": {}}), spec)
    assert "odd" in load(tmp_path).catalog.services
    tree = Tree(tmp_path)
    tree.read()
    assert tree.folders()
    assert not tree.errors


def chain(root: Path, kind: str, field: str, end: str) -> None:
    folder = root / f"{kind.lower()}s"
    folder.mkdir(exist_ok=True)
    for n in range(1500):
        after = f"c{n + 1:04}" if n < 1499 else end
        head = f"apiVersion: rorg/v1\nkind: {kind}\nmetadata: {{name: c{n:04}}}\n"
        (folder / f"c{n:04}.yaml").write_text(f"{head}spec: {{{field}: [{after}]}}\n")


def test_a_chain_of_1500_profiles_is_merged(tmp_path):
    chain(write_tree(tmp_path, {"camera": {"profile": "c0000"}}), "Profile", "extends", "plain")
    began = time.process_time()
    found = load(tmp_path)
    assert not found.errors
    assert desire(found.catalog).digests["camera"]
    assert time.process_time() - began < 5.0


def test_profiles_that_extend_two_others_each_are_merged_once(tmp_path):
    profiles = {f"{x}{n:02}": {"extends": [f"a{n - 1:02}", f"b{n - 1:02}"]} for n in range(1, 40) for x in "ab"}
    write_tree(tmp_path, {"camera": {"profile": "a39"}}, profiles={**profiles, "a00": {}, "b00": {"common": False}})
    began = time.process_time()
    assert load(tmp_path).catalog is not None
    assert time.process_time() - began < 5.0


def test_what_nobody_thought_of_is_an_error_of_the_tree(tmp_path, monkeypatch):
    write_tree(tmp_path, {"camera": {}})
    monkeypatch.setattr("rorg.manifest.load.inputs", lambda *_: 1 // 0)
    (error,) = load(tmp_path).errors
    assert error.where == Where(str(tmp_path))
    assert "ZeroDivisionError" in error.message


@pytest.mark.slow
def test_an_rorg_that_begins_on_all_of_them_tells_each_and_keeps_what_runs(tmp_path):
    """What is wrong while it runs is still told after a restart, when no good tree was seen yet."""
    robot = RealRobot(tmp_path, "process", None, with_server=True)

    def told() -> set[str]:
        return {Path(error["file"]).stem for error in robot.client().status()["tree"]["errors"]}

    try:
        robot.declare({"camera": {"always_on": True}})
        robot.wait(lambda: "camera" in robot.active())
        run = robot.container("camera").incarnation
        odd = {f"odd{n:02}" for n, spec in enumerate(SPEC.values()) if write(robot.tree, spec, f"odd{n:02}")}
        robot.loop.wakes.files_changed()
        robot.wait(lambda: told() == odd)
        robot.stop()
        robot.start()
        assert told() == odd
        assert robot.container("camera").incarnation == run
        shutil.rmtree(robot.tree / "services")
        robot.declare({"camera": {"always_on": True}, "lidar": {"always_on": True}})
        robot.loop.wakes.files_changed()
        robot.wait(lambda: robot.active() == {"camera", "lidar"} and not told())
        assert robot.container("camera").incarnation == run
    finally:
        robot.close()
