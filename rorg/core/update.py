"""What is remembered of the changes of a service, from one container or content to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

MOST = 16
"""Editions of a service of which it is remembered that they failed."""


@dataclass(frozen=True, slots=True)
class Update:
    """Of one service. An edition is all that its manifest says of its container and of when that is ready."""

    edition: str = ""
    """The one that is desired; what failed of another one holds back nothing."""
    since: float = 0.0
    """When that came to be desired, by the loop's clock; 0 if this rorg found it so."""
    quarantined: Mapping[str, str] = field(default_factory=dict)
    """Edition that did not come up or stay well, so that the container before was gone back to -> why. It is not tried
    again by itself. The last ones, oldest first."""
    lifted: str = ""
    """When the quarantine was asked to be lifted last, as far as that was done."""
    proven: str = ""
    """Id of the container that has passed its trial, though the one before it is still there."""
    baked: str = ""
    """The edition that was seen to stay well last."""
    drawn: str = ""
    """Why its change is not made, or is undone, though nothing is wrong with it: that of one of its set failed."""
    held: str = ""
    """For whom of its set the new container waits before it takes the place of the one before."""
    run: str = ""
    """The incarnation that `content` is about."""
    content: Mapping[str, str] = field(default_factory=dict)
    """What that run has read: mounted path -> digest of what was there."""
    begun: Mapping[str, str] | None = None
    """Once we begin a start, until it is seen to run: what was there then."""

    @property
    def failed(self) -> str:
        """Why the edition that is desired is not tried; empty where nothing is against it."""
        return self.quarantined.get(self.edition) or self.drawn

    def quarantine(self, error: str) -> Update:
        """With the edition that is desired not to be tried again."""
        last = [(e, why) for e, why in self.quarantined.items() if e != self.edition][-(MOST - 1) :]
        return replace(self, quarantined={**dict(last), self.edition: error})
