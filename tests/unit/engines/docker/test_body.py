"""Every option of the container section reaches the engine."""

from __future__ import annotations

import pytest

from rorg.engines.docker.body import OPTIONS, create_body
from rorg.engines.docker.inspection import live_options, update_body
from rorg.manifest.container import ContainerOptions

NOT_SENT = {"env_file"}
"""Read when the manifest is rendered: its lines become `environment`."""


def test_no_option_is_dropped():
    assert set(OPTIONS) == set(ContainerOptions.model_fields) - NOT_SENT | {"image", "command"}


CASES = [
    ({"cpus": 0.5}, {"HostConfig": {"NanoCpus": 500000000}}),
    (
        {"devices": ["/dev/a:/dev/b:r", "/dev/c"]},
        {
            "HostConfig": {
                "Devices": [
                    {"PathOnHost": "/dev/a", "PathInContainer": "/dev/b", "CgroupPermissions": "r"},
                    {"PathOnHost": "/dev/c", "PathInContainer": "/dev/c", "CgroupPermissions": "rwm"},
                ]
            }
        },
    ),
    (
        {"ports": ["127.0.0.1:80:8080/udp"]},
        {
            "ExposedPorts": {"8080/udp": {}},
            "HostConfig": {"PortBindings": {"8080/udp": [{"HostIp": "127.0.0.1", "HostPort": "80"}]}},
        },
    ),
    (
        {"ports": ["7000-7001:8000-8001"]},
        {
            "ExposedPorts": {"8000/tcp": {}, "8001/tcp": {}},
            "HostConfig": {
                "PortBindings": {
                    "8000/tcp": [{"HostIp": "", "HostPort": "7000"}],
                    "8001/tcp": [{"HostIp": "", "HostPort": "7001"}],
                }
            },
        },
    ),
    (
        {"ports": ["8080"]},
        {
            "ExposedPorts": {"8080/tcp": {}},
            "HostConfig": {"PortBindings": {"8080/tcp": [{"HostIp": "", "HostPort": ""}]}},
        },
    ),
    ({"volumes": ["a:/b:ro", "/c"]}, {"Volumes": {"/c": {}}, "HostConfig": {"Binds": ["a:/b:ro"]}}),
    ({"environment": {"B": "2", "A": "1"}}, {"Env": ["A=1", "B=2"], "HostConfig": {}}),
    ({"restart": "on-failure:3"}, {"HostConfig": {"RestartPolicy": {"Name": "on-failure", "MaximumRetryCount": 3}}}),
    (
        {"gpus": [{"count": "all"}]},
        {
            "HostConfig": {
                "DeviceRequests": [
                    {"Driver": "", "Count": -1, "DeviceIDs": None, "Capabilities": [["gpu"]], "Options": {}}
                ]
            }
        },
    ),
    (
        {"ulimits": {"nofile": {"soft": 1, "hard": 2}}},
        {"HostConfig": {"Ulimits": [{"Name": "nofile", "Soft": 1, "Hard": 2}]}},
    ),
    ({"tmpfs": ["/run:size=1m"]}, {"HostConfig": {"Tmpfs": {"/run": "size=1m"}}}),
    (
        {"healthcheck": {"test": ["CMD", "x"], "interval": 2.0}},
        {
            "Healthcheck": {"Test": ["CMD", "x"], "Interval": 2000000000, "Timeout": 0, "Retries": 0, "StartPeriod": 0},
            "HostConfig": {},
        },
    ),
]


@pytest.mark.parametrize(("spec", "expected"), CASES)
def test_option_as_body(spec, expected):
    assert create_body(spec, {}) == {"Labels": {}, **expected}


def test_live_options_come_back_as_they_were_declared():
    declared = {
        "cpus": 0.5,
        "mem_limit": 1 << 30,
        "cpu_shares": 512,
        "restart": "on-failure:3",
        "pids_limit": 99,
        "cpuset": "0-1",
    }
    found = live_options(create_body(declared, {})["HostConfig"])
    assert {k: found[k] for k in declared} == declared


def test_a_memory_limit_moves_the_limit_of_swap_along():
    assert update_body({"mem_limit": 100}) == {"Memory": 100, "MemorySwap": 200}
