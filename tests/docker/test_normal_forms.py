"""Containers that would be the same are not replaced on Docker, however their options are written."""

from __future__ import annotations

FIRST = {
    "cap_add": ["SYS_NICE", "NET_ADMIN"],
    "cap_drop": ["MKNOD"],
    "group_add": ["44", "20"],
    "security_opt": ["no-new-privileges", "label=disable"],
    "volumes": ["maps:/maps:ro", "/tmp:/host"],
    "devices": ["/dev/null", "/dev/zero:/dev/nil:r"],
    "tmpfs": ["/run", "/scratch:size=1m,mode=700"],
    "restart": "on-failure",
    "stop_signal": "SIGINT",
    "ulimits": {"nofile": 1024},
    "pids_limit": 100,
}

SECOND = {
    "cap_add": ["cap_net_admin", "SYS_NICE", "SYS_NICE"],
    "cap_drop": ["CAP_MKNOD"],
    "privileged": False,
    "security_opt": ["label:disable", "no-new-privileges:true"],
    "volumes": ["/tmp:/host/:rw", "maps:/maps:ro"],
    "devices": ["/dev/zero:/dev/nil:r", "/dev/null:/dev/null:rwm"],
    "group_add": ["20", "44"],
    "tty": False,
    "tmpfs": ["/scratch:mode=700,size=1m", "/run"],
    "read_only": False,
    "stdin_open": False,
    "dns": [],
    "restart": "on-failure:0",
    "stop_signal": "2",
    "ulimits": {"nofile": {"soft": 1024, "hard": 1024}},
    "pids_limit": 100,
    "oom_kill_disable": False,
    "sysctls": {},
    "links": [],
    "cpu_shares": 0,
}


def test_another_spelling_restarts_nothing(docker_robot):
    robot = docker_robot
    robot.declare({"arm": {"always_on": True, "container": FIRST}, "base": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"arm", "base"})
    before = {c.service: c.incarnation for c in robot.containers()}
    robot.declare({"arm": {"always_on": True, "container": SECOND}, "base": {"always_on": True}})
    robot.settle()
    assert {c.service: c.incarnation for c in robot.containers()} == before
    robot.declare(
        {"arm": {"always_on": True, "container": {**SECOND, "cap_add": ["SYS_NICE"]}}, "base": {"always_on": True}}
    )
    robot.wait(lambda: robot.active() == {"arm", "base"} and robot.container("arm").incarnation != before["arm"])
    robot.settle()
    assert robot.container("base").incarnation == before["base"]


def test_no_limit_is_not_set_again_and_again(docker_robot):
    robot = docker_robot
    options = {"pids_limit": -1, "restart": "on-failure:0", "mem_limit": 0, "cpu_quota": -1, "memswap_limit": -1}
    robot.declare({"arm": {"always_on": True, "container": options}})
    robot.wait(lambda: robot.active() == {"arm"})
    robot.settle()
    assert not [line for line in robot.log() if "update" in line]
    before = robot.container("arm").incarnation
    robot.declare({"arm": {"always_on": True, "container": {**options, "pids_limit": 100}}})
    robot.wait(lambda: robot.container("arm").live["pids_limit"] == 100)
    robot.declare({"arm": {"always_on": True, "container": options}})
    robot.wait(lambda: robot.container("arm").live["pids_limit"] == 0)
    robot.settle()
    assert robot.container("arm").incarnation == before
