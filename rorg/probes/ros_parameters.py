"""Sets ROS 1 parameters at a master, through its XML-RPC: 1 ms for each.

What was set for a service is marked at the master itself, so a master that was restarted, and an rorg that was, are
told from a value that somebody has changed by hand since: that one stays.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from rorg.host.deadline import Deadline
from rorg.probes.ros_master import CALLER, TIMEOUT, call

MARKS = "/rorg/parameters"
"""Namespace at the master: by service, the digest of what was set for it."""
SETTING = 10.0
"""Seconds for all parameters of a service."""


def ensure(master: str, service: str, digest: str, values: Mapping[str, Any], anew: bool) -> bool:
    """Sets what a service declares, unless the master has it; `anew`: whether or not. Returns whether anything was set.
    Raises OSError when the master gives no answer, LookupError when it refuses."""
    whole = Deadline.within(SETTING)
    mark = f"{MARKS}/{re.sub(r'[^A-Za-z0-9_]', '_', service)}"
    if not anew and _marked(master, mark, whole) == digest:
        return False
    for name, value in {**values, mark: digest}.items():
        call(master, "setParam", CALLER, name, value, deadline=whole.sooner(TIMEOUT))
    return True


def _marked(master: str, mark: str, whole: Deadline) -> str:
    try:
        return str(call(master, "getParam", CALLER, mark, deadline=whole.sooner(TIMEOUT)))
    except LookupError:
        return ""
