"""What services declare of ROS 1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class RosParameters:
    """What the master of a service is given before the service starts."""

    master: str
    """Its URI."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """By absolute name, in plain JSON: what XML-RPC can carry."""
