"""Sets ROS 1 parameters at a master by XML-RPC: 1 ms each.

The digest of what was set is kept at the master itself. So a restarted master gets the parameters again, while a value
that someone changed by hand stays, even over a restart of rorg.
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
    """Set the declared parameters of a service unless the master has them; with `anew` in any case. Return whether they
    were set. Raises OSError if the master does not answer, LookupError if it refuses."""
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
