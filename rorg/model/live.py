"""Options that an engine changes without a new container (docker update, docker rename)."""

from __future__ import annotations

LIVE = frozenset(
    (
        "container_name",
        "cpu_period",
        "cpu_quota",
        "cpu_rt_period",
        "cpu_rt_runtime",
        "cpu_shares",
        "cpus",
        "cpuset",
        "cpuset_mems",
        "mem_limit",
        "mem_reservation",
        "memswap_limit",
        "pids_limit",
        "restart",
    )
)
"""The marks of manifest/container.py, where the core can see them; a test holds the two together."""
