"""What is remembered of the changes of a service, from one container or content to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Update:
    """Of one service. An edition is all that its manifest says of its container and of when that is ready."""

    edition: str = ""
    """The one that is desired; what failed of another one holds back nothing."""
    failed: str = ""
    """The edition whose container did not come up, so that the one before it was gone back to."""
    error: str = ""
    """Why."""
    proven: str = ""
    """Id of the container that has passed its trial, though the one before it is still there."""
    run: str = ""
    """The incarnation that `content` is about."""
    content: Mapping[str, str] = field(default_factory=dict)
    """What that run has read: mounted path -> digest of what was there."""
    begun: Mapping[str, str] | None = None
    """Once we begin a start, until it is seen to run: what was there then."""
