"""rorg in a whole machine, as a user has it: Debian's systemd, control groups v2, the Debian package, a reboot."""

from __future__ import annotations

import json
import os
import random
import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import pytest
from common import wait_for
from vm.cuts import Book, call_until_the_cut, check
from vm.disk_cache import ENTRY, FLUSH, HEAD, MAGIC, replay
from vm.guest import Guest
from vm.robot import PERSON, Robot

CUTS = int(os.environ.get("CUTS") or 3)
OUT = ["python3", "-S", "-u", "-c"]
BUSY = [*OUT, "block = b'x' * (40 << 20)\nwhile True: pass"]
HOARD = [
    *OUT,
    "import os, signal\nsignal.signal(2, lambda *_: os._exit(0))\n"
    "x = bytearray(os.urandom(64 << 20))\nwhile True: signal.pause()",
]
GLUTTON = [*OUT, "blocks = []\nwhile True: blocks.append(b'x' * (1 << 20))"]
SERVICES: dict[str, dict] = {
    "camera": {"idle": {"action": "pause"}},
    "arm": {"needs": ["camera"]},
    "busy": {"command": BUSY},
    "hoarder": {"command": HOARD, "idle": {"action": "pause", "reclaim": True}},
    "glutton": {"command": GLUTTON, "container": {"mem_limit": "48Mi", "memswap_limit": "48Mi"}},
}


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    guest = Guest("machine")
    try:
        yield Robot(guest, SERVICES)
    finally:
        guest.close()


def test_systemd_runs_rorg_from_its_package(robot):
    guest = robot.guest
    assert guest.sh("stat -fc %T /sys/fs/cgroup").strip() == "cgroup2fs"
    assert guest.sh("docker info -f '{{.CgroupDriver}} {{.CgroupVersion}}'").strip() == "systemd 2"
    assert guest.sh("systemctl is-active rorg; systemctl is-enabled rorg").split() == ["active", "enabled"]
    checks = {check["check"]: check for check in json.loads(guest.sh("rorg doctor -o json"))}
    assert "v2" in checks["cgroup"]["message"]
    assert {name for name, check in checks.items() if check["status"] == "error"} == set()
    assert checks["pressure"]["status"] == "ok"


def test_a_member_of_the_group_requests_and_releases(robot):
    robot.rorg("request arm --wait --timeout 2m")
    assert robot.service("arm")["health"] == "Healthy"
    robot.rorg("release arm")
    robot.becomes("arm", "exited")
    robot.becomes("camera", "paused")
    code, output = robot.guest.run("runuser -u nobody -- rorg request arm")
    assert code != 0, output


def test_a_paused_service_is_frozen(robot):
    robot.rorg("request camera --wait --timeout 2m")
    group = robot.control_group("camera")
    assert "frozen 0" in robot.guest.sh(f"cat {group}/cgroup.events")
    robot.rorg("release camera")
    robot.becomes("camera", "paused")
    assert robot.guest.sh(f"cat {group}/cgroup.freeze").strip() == "1"
    assert "frozen 1" in robot.guest.sh(f"cat {group}/cgroup.events")
    robot.rorg("request camera --wait --timeout 2m")
    assert "frozen 0" in robot.guest.sh(f"cat {group}/cgroup.events")
    robot.rorg("release camera")


def test_top_tells_use_and_pressure(robot):
    robot.rorg("request busy --wait --timeout 2m")
    rivals = " ".join("timeout 60 sh -c 'while :; do :; done' &" for _ in range(3))
    robot.guest.sh(f"({rivals}) >/dev/null 2>&1 </dev/null")

    def seen() -> bool:
        top = robot.json("top --once")
        busy = next(s for s in top["services"] if s["service"] == "busy")
        return 0.1 < busy["cpu"] < 1.5 and 40 << 20 < busy["memory"] < 80 << 20 and top["machine"]["cpu_some"] > 5

    wait_for(seen, 60, "figures of use and pressure")
    robot.rorg("release busy")
    robot.becomes("busy", "exited")


def test_memory_of_a_paused_service_is_pushed_out_to_swap(robot):
    guest = robot.guest
    guest.sh("fallocate -l 256M /swap && chmod 600 /swap && mkswap /swap && swapon /swap")
    robot.rorg("request hoarder --wait --timeout 2m")
    group = robot.control_group("hoarder")
    wait_for(lambda: anonymous(guest, group) > 60 << 20, 60, "64 MiB of memory")
    before = robot.service("hoarder")["incarnation"]
    robot.rorg("release hoarder")
    told = wait_for(lambda: re.search(r"(\d+)Mi of hoarder pushed out to swap", robot.log()), 60, "the reclaim")
    assert int(told[1]) > 32
    assert anonymous(guest, group) < 32 << 20
    robot.rorg("request hoarder --wait --timeout 2m")
    assert robot.service("hoarder")["incarnation"] == before
    robot.rorg("release hoarder")
    guest.sh("swapoff /swap && rm /swap")


def anonymous(guest: Guest, group: str) -> int:
    """Bytes of memory that are of no file."""
    return int(guest.sh(f"sed -n 's/^anon //p' {group}/memory.stat"))


def test_an_end_by_the_memory_limit_is_told(robot):
    robot.rorg("request glutton")
    ends = wait_for(lambda: robot.events("glutton --kind crashed"), 120, "the end of the program")
    assert all("out of memory" in event["message"] for event in ends), ends
    robot.rorg("release glutton")


INSIDE = """cd /src
export PYTHONPATH=/opt/site:/src:/src/clients/python PYTHONPYCACHEPREFIX=/var/cache/python LC_ALL=C.UTF-8
export HYPOTHESIS_STORAGE_DIRECTORY=/tmp/hypothesis RORG_TEST_REQUIRE_DOCKER=1
exec python3 -m pytest -q --durations=3 """


def test_what_concerns_control_groups_passes_inside(robot):
    files = "tests/docker/test_cgroups.py tests/docker/test_reclaim.py tests/engines/test_engine_needs.py"
    code, output = robot.guest.run(f"{INSIDE} -m docker {files}", 1800)
    print(output)
    assert code == 0


def test_a_reboot(robot):
    """What was asked for is there again, and nothing else."""
    robot.rorg("request arm --id tour --reason tour --wait --timeout 2m")
    robot.rorg("request hoarder --wait --timeout 2m")
    robot.rorg("release hoarder")
    asked = robot.json("get requests")
    runs = {name: robot.service(name)["incarnation"] for name in ("arm", "camera")}
    robot.guest.reboot()
    wait_for(lambda: robot.guest.run("rorg wait arm --timeout 3m", 200)[0] == 0, 300, "arm to be ready")
    assert robot.json("get requests") == asked
    assert robot.running() == {"arm", "camera"}
    assert {name: robot.service(name)["incarnation"] for name in runs}.items().isdisjoint(runs.items())
    assert not robot.events("--kind crashed --since 2m --service arm,camera")
    began = float(robot.guest.sh("systemctl show -P UserspaceTimestamp --timestamp=unix").strip().lstrip("@"))
    ready = [e["at"] for e in robot.events("arm --kind state") if e["state"] == "ready"][-1]
    print(f"vm: ready {datetime.fromisoformat(ready).timestamp() - began:.0f} s after userland began")


def test_the_demo_passes(robot):
    code, output = robot.guest.run("rorg demo --engine docker --speed 4", 1800)
    print(output)
    assert code == 0
    assert "all untouched" in output
    assert "bug:" not in output


def test_the_book_finds_what_is_lost_and_what_is_back():
    book = Book()
    for line in ('["asks", "a", "1"]', '["has", "a", "1"]', '["asks", "b", "2"]', '["has", "b", "2"]'):
        book.note(line)
    assert book.problems({"a": "1", "b": "2"}) == []
    assert len(book.problems({"b": "2"})) == 1
    book.note('["asks", "b", null]')
    assert book.problems({"a": "1", "b": "2"}) == book.problems({"a": "1"}) == []
    book.note('["has", "b", null]')
    assert len(book.problems({"a": "1", "b": "2"})) == 1


def test_a_replay_keeps_what_was_flushed_and_loses_the_rest(tmp_path):
    """A log as qemu writes it: two writes, a flush, another write."""
    log, disk = tmp_path / "log", tmp_path / "disk"
    wrote = [(0, 1, 0), (2, 1, 0), (0, 0, FLUSH), (2, 1, 0)]
    parts = [HEAD.pack(MAGIC, 1, len(wrote), 512).ljust(512, b"\0")]
    for number, (sector, count, flags) in enumerate(wrote):
        parts += [ENTRY.pack(sector, count, flags, 0).ljust(512, b"\0"), bytes([number + 1]) * 512 * count]
    log.write_bytes(b"".join(parts))
    for kept, last in ((0.0, 2), (1.0, 4)):
        disk.write_bytes(bytes(2048))
        assert replay(log, disk, random.Random(), kept) == (1, 1 if kept == 0.0 else 0)
        assert disk.read_bytes()[::512] == bytes([1, 0, last, 0])


def test_acknowledged_requests_survive_power_cuts(robot):
    """None is lost, and none is back that was released."""
    guest, dice, book = robot.guest, random.Random(), Book()
    for request in robot.json("get requests"):
        robot.rorg(f"release {request['id']} --yes")
    guest.put(Path(__file__).parent / "caller.py", "/opt/caller.py")
    guest.power_off()
    for cut in range(CUTS):
        guest.boot(write_cache=True)
        if cut:
            check(robot, book)
        call_until_the_cut(robot, f"{cut}", book, dice)
    guest.boot()
    check(robot, book)


def test_rorg_noticed_no_bug_of_its_own(robot):
    assert "bug:" not in robot.log()
    assert robot.guest.sh("systemctl --failed --plain --no-legend") == ""
    assert PERSON in robot.guest.sh("journalctl -u rorg.service -o cat --no-pager"), "the author of requests"
