"""What the release of an engine lacks, of that which rorg could use.

Docker lacks nothing since 20.10. Podman does, depending on its release, on who runs it, and on what is installed
beside it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import Refused
from rorg.model.engines import DEFAULT_ENGINE, ENGINES, Capabilities
from rorg.model.options import OPTIONS

LIMITS = frozenset(
    (
        *("blkio_config", "cgroup_parent", "cpu_period", "cpu_quota", "cpu_rt_period", "cpu_rt_runtime", "cpu_shares"),
        *("cpus", "cpuset", "cpuset_mems", "device_cgroup_rules", "mem_limit", "mem_reservation", "mem_swappiness"),
        *("memswap_limit", "oom_kill_disable", "pids_limit"),
    )
)
"""Options that are settings of a control group."""
INIT = ("/usr/libexec/podman/catatonit", "/usr/lib/podman/catatonit", "/usr/local/libexec/podman/catatonit")
"""Where Podman looks for the program of `init`, besides PATH."""
SYSTEMD = Path("/run/systemd/system")
"""Exists while systemd is PID 1 (sd_booted(3))."""


def capabilities(client: Client) -> Capabilities:
    """Ask an engine what it can do. Raises as Client does."""
    can = ENGINES[DEFAULT_ENGINE]
    if not client.release.podman:
        return can
    can = can._replace(update=_updates(client))
    if _without_groups(client.get("/info")):
        return can._replace(pause=False, options=frozenset(OPTIONS) - LIMITS)
    return can


def lacking(client: Client, info: Mapping[str, Any]) -> dict[str, str]:
    """Return option of a container -> what this engine does with it instead, and why. `info`: its answer to /info."""
    if not client.release.podman:
        return {}
    # Accepted without a word by the API of Podman 4; later ones were not tried.
    untold = ("runtime", "gpus") if client.release.version.startswith("4.") else ()
    lacks = dict.fromkeys(untold, "ignored, because the API of Podman 4 does not take it")
    if _without_groups(info):
        lacks |= dict.fromkeys(sorted(LIMITS), "ignored, because rootless Podman has no control groups of version 1")
    if info.get("Rootless"):
        lacks["ulimits"] = "ignored, because the API of rootless Podman takes none"
    if client.host.startswith(("unix://", "/")):
        if not SYSTEMD.exists():
            lacks["healthcheck"] = "never checked, because Podman leaves that to systemd, which does not run here"
        if not shutil.which("catatonit") and not any(os.path.exists(path) for path in INIT):
            lacks["init"] = "refused, because Podman needs catatonit for it, which is not installed"
    return lacks


def _without_groups(info: Mapping[str, Any]) -> bool:
    """A user may not make control groups of version 1: nothing is limited or frozen."""
    return bool(info.get("Rootless")) and str(info.get("CgroupVersion")) == "1"


def _updates(client: Client) -> bool:
    """Podman 4 has no call that changes limits in place: it does not know the path. Later ones miss the container."""
    try:
        client.post("/containers/none/update", {})
    except Refused as no:
        return "container" in no.text.lower()
    return True
