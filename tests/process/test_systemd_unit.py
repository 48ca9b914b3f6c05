"""The systemd unit: what it denies rorg, what it leaves it for its work, and what the process engine gives back."""

from __future__ import annotations

import subprocess
from pathlib import Path

from common import ROOT
from tools import tool

HARD = {
    "NoNewPrivileges": "yes",
    "ProtectSystem": "strict",
    "ProtectHome": "read-only",
    "PrivateTmp": "yes",
    "PrivateDevices": "yes",
    "ProtectClock": "yes",
    "ProtectHostname": "yes",
    "ProtectKernelLogs": "yes",
    "ProtectKernelModules": "yes",
    "ProtectKernelTunables": "yes",
    "RestrictNamespaces": "yes",
    "RestrictRealtime": "yes",
    "RestrictSUIDSGID": "yes",
    "LockPersonality": "yes",
    "MemoryDenyWriteExecute": "yes",
    "SystemCallArchitectures": "native",
    "RestrictAddressFamilies": "AF_UNIX AF_INET AF_INET6",
}
LIMITS = ("MemoryMax", "TasksMax", "LimitNOFILE", "StateDirectoryMode", "RuntimeDirectoryMode", "UMask", "WatchdogSec")
NEEDED = {"CAP_CHOWN", "CAP_DAC_OVERRIDE", "CAP_FOWNER", "CAP_KILL", "CAP_SYS_PTRACE", "CAP_SETGID", "CAP_SETUID"}
"""The group of a socket, a tree of another owner, the end of a command in a container, its files below /proc; git as
the owner of a repository."""
UNSET = {
    "ProtectControlGroups": "memory.reclaim is written",
    "ProtectProc": "the processes of containers are looked at",
    "ProcSubset": "the machine's load is read",
    "PrivateNetwork": "ports are probed",
    "PrivateUsers": "who calls is told by the kernel",
    "User": "it has the engine's socket, which is root",
}
"""What cannot be denied."""
OWN = {"ReadWritePaths", "SystemCallErrorNumber", "StateDirectoryMode", "RuntimeDirectoryMode", "UMask", "WatchdogSec"}
"""What services do not inherit, or what says nothing without the rest."""


def directives(name: str) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in (ROOT / "images/rorg" / name).read_text().splitlines():
        key, equals, value = line.partition("=")
        if equals and not line.startswith("#"):
            found.setdefault(key, []).append(value)
    return found


def test_the_unit_denies_what_rorg_does_not_need():
    unit = directives("rorg.service")
    assert {key: unit.get(key) for key in HARD} == {key: [value] for key, value in HARD.items()}
    assert set(unit["CapabilityBoundingSet"][0].split()) == NEEDED
    assert unit["SystemCallFilter"] == ["@system-service", "~@privileged @resources", "@chown @setuid"]
    assert unit.keys() >= set(LIMITS)
    assert not unit.keys() & UNSET.keys()


def test_a_machine_without_a_robot_starts_nothing_and_nothing_fails():
    for name in ("rorg.service", "process.conf"):
        assert directives(name)["ExecStart"][-1].startswith("rorg run /opt/robot/manifests "), "of any folder of PATH"
    assert directives("rorg.service")["ConditionDirectoryNotEmpty"] == ["/opt/robot/manifests"]


def test_directories_are_made_before_it_as_it_would_make_them():
    unit, text = directives("rorg.service"), (ROOT / "images/rorg/tmpfiles.conf").read_text()
    made = {line.split()[1]: line.split()[2:] for line in text.splitlines() if not line.startswith("#")}
    assert made == {
        "/run/" + unit["RuntimeDirectory"][0]: [unit["RuntimeDirectoryMode"][0], "root", "root", "-"],
        "/var/lib/" + unit["StateDirectory"][0]: [unit["StateDirectoryMode"][0], "root", "root", "-"],
    }


def test_systemd_understands_it(tmp_path):
    systemd = tool("systemd-analyze")
    (tmp_path / "rorg.service.d").mkdir()
    for name in ("rorg.service", "rorg.service.d/process.conf"):
        text = (ROOT / "images/rorg" / Path(name).name).read_text()
        (tmp_path / name).write_text(text.replace("ExecStart=rorg ", "ExecStart=/bin/true "))
    said = subprocess.run([systemd, "verify", "--man=no", tmp_path / "rorg.service"], capture_output=True, text=True)
    assert (said.returncode, said.stderr) == (0, "")


def test_services_of_the_process_engine_inherit_nothing_of_that():
    """They are rorg's children: a denial that is not taken back would break a person's program."""
    unit, given = directives("rorg.service"), directives("process.conf")
    inherited = {*HARD, *LIMITS, "CapabilityBoundingSet", "SystemCallFilter"} - OWN
    assert inherited <= unit.keys()
    assert {key for key in inherited if key not in given or given[key] == unit[key]} == set()
    assert given["KillMode"] == ["process"], "they go on while rorg is restarted"
    assert given["ExecStart"][0] == "", "else there are two"
    assert "--engine process" in given["ExecStart"][1]
