"""The systemd unit: what it denies rorg, what it leaves it for its work, and what the process engine gives back."""

from __future__ import annotations

from conftest import ROOT

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
NEEDED = {"CAP_CHOWN", "CAP_DAC_OVERRIDE", "CAP_FOWNER", "CAP_KILL", "CAP_SYS_PTRACE"}
"""The group of a socket, a tree of another owner, the end of a command in a container, its files below /proc."""
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
    assert unit["SystemCallFilter"] == ["@system-service", "~@privileged @resources", "@chown"]
    assert unit.keys() >= set(LIMITS)
    assert not unit.keys() & UNSET.keys()


def test_services_of_the_process_engine_inherit_nothing_of_that():
    """They are rorg's children: a denial that is not taken back would break a person's program."""
    unit, given = directives("rorg.service"), directives("process.conf")
    inherited = {*HARD, *LIMITS, "CapabilityBoundingSet", "SystemCallFilter"} - OWN
    assert inherited <= unit.keys()
    assert {key for key in inherited if key not in given or given[key] == unit[key]} == set()
    assert given["KillMode"] == ["process"], "they go on while rorg is restarted"
    assert given["ExecStart"][0] == "", "else there are two"
    assert "--engine process" in given["ExecStart"][1]
