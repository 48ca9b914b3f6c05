"""What a request can lose."""

from __future__ import annotations

from typing import NamedTuple


class Loss(NamedTuple):
    """A service that was ready under a request is no longer. `cause` is a stable word: held, shed, preempted,
    restarted, crashed, hung, replaced, unready or ceased; or dropped, if the request itself is gone."""

    service: str
    """Empty if the request itself is gone."""
    cause: str
    reason: str
    """Why, for people."""
    incarnation: str = ""
    """The run that was lost."""

    @property
    def message(self) -> str:
        """The older name of `reason`."""
        return self.reason
