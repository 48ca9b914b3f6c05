"""What dead DDS participants left: which files are theirs, which are in use, and which are removed."""

from __future__ import annotations

import fcntl
import mmap
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from common import wait_for

from rorg.core.shared_memory import group_of, participants
from rorg.host.shared_memory import ALL_PROCESSES, ASIDE, in_use, remove_unused
from rorg.model.catalog import Service

SEGMENT = ("fastrtps_009f107a8c16c702", "fastrtps_009f107a8c16c702_el")
PORT = ("fastrtps_port7412", "fastrtps_port7412_el", "sem.fastrtps_port7412_mutex")
OTHERS = ("iox_mgmt", "sem.x", "fastrtps", "PostgreSQL.1", ".rorg-x")
pytestmark = pytest.mark.skipif(
    os.geteuid() != 0 or os.stat("/proc/self/ns/pid").st_ino != ALL_PROCESSES,
    reason="who is not root, or in a container, does not see the files of all processes",
)


@pytest.fixture
def shm(tmp_path) -> Path:
    for name in (*SEGMENT, *PORT, *OTHERS):
        (tmp_path / name).write_bytes(b"x" * 10)
    return tmp_path


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def clean(folder: Path, **more) -> set[str]:
    """Names that stay."""
    remove_unused(folder, group_of, time.time() + 1, **more)
    return names(folder)


def test_files_of_one_segment_or_port_belong_together():
    assert {group_of(name) for name in SEGMENT} == {SEGMENT[0]}
    assert {group_of(name) for name in (*PORT, "fastrtps_port7412_sl")} == {PORT[0]}
    assert group_of("fastdds_009f107a8c16c702_el") == "fastdds_009f107a8c16c702", "as Fast DDS 3 calls it"
    assert {group_of(name) for name in OTHERS} == {""}


def test_a_participant_has_the_machines_memory_and_a_variable_of_ros2():
    env = {"ROS_DOMAIN_ID": "0"}
    specs = {
        "node": {"ipc": "host", "environment": env},
        "alone": {"ipc": "private", "environment": env},
        "browser": {"ipc": "host", "environment": {"DISPLAY": ":0"}},
    }
    services = {name: Service(name, spec=spec) for name, spec in specs.items()}
    assert participants({**services, "meta": Service("meta")}) == {"node"}


def test_what_nobody_uses_is_removed_and_counted(shm):
    removed = remove_unused(shm, group_of, time.time() + 1)
    assert (removed.files, names(shm)) == (5, set(OTHERS))
    assert removed.size >= 5 * 10


def test_what_is_younger_than_the_end_of_the_last_participant_stays(shm):
    assert remove_unused(shm, group_of, time.time() - 60).files == 0
    assert len(names(shm)) == 10


@pytest.mark.parametrize(
    "program",
    ["f = open(NAME); ", "f = open(NAME); m = mmap.mmap(f.fileno(), 0, prot=mmap.PROT_READ); f.close(); "],
    ids=["open", "mapped"],
)
def test_what_another_process_has_open_or_mapped_stays_with_its_group(shm, program):
    code = f"import mmap; {program.replace('NAME', repr(str(shm / PORT[0])))}print(1, flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline() == b"1\n"
        assert clean(shm) == {*PORT, *OTHERS}
        other.stdin.close()
    assert clean(shm) == set(OTHERS)


def test_what_is_locked_stays(shm):
    with (shm / SEGMENT[1]).open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        assert clean(shm) == {*SEGMENT, *OTHERS}


def test_what_is_opened_between_the_looks_is_put_back(shm):
    """A participant that starts just now finds it, or makes its own: never a file without a name."""
    opened = []

    def look(files):
        used = in_use(files)
        if not opened:
            opened.append((shm / PORT[0]).open("rb"))
        return used

    assert clean(shm, look=look) == {*PORT, *OTHERS}
    assert os.fstat(opened[0].fileno()).st_ino == (shm / PORT[0]).stat().st_ino
    opened[0].close()


def test_all_is_put_back_where_the_second_look_fails(shm):
    looks = []

    def look(files):
        looks.append(files)
        if len(looks) == 2:
            raise PermissionError
        return set()

    with pytest.raises(PermissionError):
        clean(shm, look=look)
    assert names(shm) == {*SEGMENT, *PORT, *OTHERS}


def test_what_a_killed_rorg_had_set_aside_is_removed(shm):
    (shm / SEGMENT[0]).rename(shm / f"{ASIDE}{SEGMENT[0]}")
    assert clean(shm) == set(OTHERS)


def test_a_mapping_counts_as_long_as_it_lasts(shm):
    path = shm / SEGMENT[0]
    with path.open("r+b") as file:
        mapped = mmap.mmap(file.fileno(), 0)
    assert in_use([path]) == {path}
    mapped.close()
    wait_for(lambda: in_use([path]) == set())


@pytest.mark.parametrize("real_robot", ["process"], indirect=True)
def test_the_policy_says_whether_anything_is_removed(real_robot):
    real_robot.shm.mkdir()
    left = real_robot.shm / SEGMENT[0]
    left.write_bytes(b"x")
    wait_for(lambda: left.stat().st_ctime < time.time())
    node = {"node": {"profile": "ros2"}}
    real_robot.declare(node)
    real_robot.settle()
    for thread in threading.enumerate():
        if thread.name == "shm-purger":
            thread.join()
    assert left.exists(), "it may be of a program outside of rorg"
    real_robot.declare(node, policies={"robot": {"purge_shm": True}})
    real_robot.wait(lambda: not left.exists())


@pytest.mark.parametrize("real_robot", ["process"], indirect=True)
def test_nothing_is_removed_while_a_participant_lives_or_where_there_is_none(real_robot):
    real_robot.shm.mkdir()
    left = real_robot.shm / SEGMENT[0]
    purge = {"robot": {"purge_shm": True}}
    real_robot.declare({"node": {"profile": "ros2", "idle": {"action": "pause"}}, "base": {}}, policies=purge)
    real_robot.request("node")
    real_robot.wait(lambda: "node" in real_robot.active())
    left.write_bytes(b"x")
    real_robot.release()
    real_robot.wait(lambda: real_robot.states()["node"] == "paused")
    real_robot.settle()
    assert left.exists(), "a paused participant goes on"
    real_robot.declare({"base": {}}, policies={"robot": {"removals": "auto", "purge_shm": True}})
    real_robot.wait(lambda: "node" not in real_robot.states())
    real_robot.settle()
    assert left.exists(), "no service of this robot is one of ROS 2"
    real_robot.declare({"node": {"profile": "ros2"}, "base": {}}, policies=purge)
    real_robot.wait(lambda: not left.exists())
