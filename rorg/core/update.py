"""Memory of changes to a service, across its containers. It includes the content of mounted files that the current run
has read: editing a config file must reload the service that read it, and only that one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf

from rorg.core.observed import Container
from rorg.model.probe import Probe

MOST = 16
"""Failed editions that are remembered per service."""


@dataclass(frozen=True, slots=True)
class LastGood:
    """What the edition that stayed well last declared: the digest of its container, and its probes."""

    digest: str
    ready: Probe | None
    live: Probe | None


@dataclass(frozen=True, slots=True)
class Update:
    """Changes of one service. An edition is what its manifest says about the container, its files and its readiness."""

    edition: str = ""
    """The desired edition. Failures of other editions hold nothing back."""
    since: float = 0.0
    """When it became desired, or its program was told to read it, by the loop's clock; 0 if this rorg found it at its
    start. Its bake does not begin earlier."""
    quarantined: Mapping[str, str] = field(default_factory=dict)
    """Edition that failed on trial -> why; oldest first. It is not tried again unless a person asks."""
    rejected: str = ""
    """Id of the last container that failed on trial: nothing goes back to it."""
    spared: str = ""
    """Id of a container that failed on trial and was retried: that it has ended says nothing any more."""
    failed_at: float = -inf
    """When it was put there, by the loop's clock. A restart of rorg forgets that."""
    lifted: str = ""
    """When lifting the quarantine was last requested and done."""
    interrupted: int = 0
    """How often something else ended a run of the desired edition before it had stayed well."""
    proven: str = ""
    """Id of the container that passed its trial, while the previous one still exists."""
    baked: str = ""
    """The edition that stayed well last."""
    well: str = ""
    """Id of the container that stayed well last."""
    last_good: LastGood | None = None
    """Of the container `well`; None if none was proven by a rorg that notes it."""
    crashing: Mapping[str, str] = field(default_factory=dict)
    """Edition that ended again and again, though rorg goes on starting it -> why; oldest first. A release or a restart
    of rorg repairs nothing, so it stays until a run of this edition has stayed well, or a person retries."""
    drawn: str = ""
    """Why its change is not made or is undone although nothing is wrong with it: another change of its set failed."""
    held: str = ""
    """The service of its set whose new container it waits for."""
    run: str = ""
    """The incarnation that `content` is about."""
    content: Mapping[str, str] = field(default_factory=dict)
    """Content that this run has read: mounted path -> digest."""
    present: Mapping[str, str] = field(default_factory=dict)
    """The content in the last pass of this rorg."""
    begun: Mapping[str, str] | None = None
    """From rorg's start call until the service is seen running: the content at that time."""

    @property
    def failed(self) -> str:
        """Why the desired edition is not tried; "" if it may be."""
        return self.quarantined.get(self.edition) or self.drawn

    def is_rejected(self, digest: str) -> bool:
        """Return whether a container with the `digest` of the desired edition failed on trial. If the container that
        was proven has the same digest, only a probe or a file failed, which rejects none."""
        same = self.last_good is not None and self.last_good.digest == digest
        return bool(self.rejected) and self.edition in self.quarantined and not same

    def quarantine(self, error: str, now: float) -> Update:
        """Return the update with the desired edition quarantined."""
        last = list(self._others().items())[-(MOST - 1) :]
        return replace(self, quarantined={**dict(last), self.edition: error}, failed_at=now)

    def is_proven(self, container: str) -> bool:
        """Return whether the desired edition has stayed well in this container."""
        return (self.baked, self.well) == (self.edition, container)

    def accepting(self, container: str) -> Update:
        """Return the update with a container that stayed well no longer rejected: it failed with an earlier probe or
        file."""
        return replace(self, rejected="") if self.rejected == container else self

    @property
    def broken(self) -> str:
        """Why the desired edition counts as failed although rorg goes on starting it; "" if it does not."""
        return self.crashing.get(self.edition, "")

    @property
    def failures(self) -> Mapping[str, str]:
        """Return all editions that are known to fail, each with the reason."""
        return {**self.crashing, **self.quarantined}

    def noting_crashes(self, error: str) -> Update:
        """Return the update with the desired edition known to end again and again; without an `error`, no more."""
        others = {edition: why for edition, why in self.crashing.items() if edition != self.edition}
        return replace(
            self, crashing={**dict([*others.items()][-(MOST - 1) :]), **({self.edition: error} if error else {})}
        )

    def pardoned(self) -> Update:
        """Return the update with the desired edition free to be tried again. If it was proven once and failed later, it
        must be proven again."""
        baked = "" if self.broken else self.baked
        free = replace(self.noting_crashes(""), quarantined=self._others(), baked=baked, rejected="")
        free = replace(free, spared=self.rejected or self.spared)
        return replace(free, failed_at=-inf, interrupted=0)

    def _others(self) -> dict[str, str]:
        return {edition: why for edition, why in self.quarantined.items() if edition != self.edition}

    def noting(self, current: Container | None, present: Mapping[str, str]) -> Update:
        """Note what is there, and what the current run has read of it. A run that rorg started has read what was there
        at the start. One that somebody else started may have begun before the last change, so it is taken to have read
        what was there in the last pass. For a run that rorg finds at its own start, the present content is assumed,
        because a new rorg must restart nothing on its own. `present` maps mounted paths to their digests now."""
        noted = self if current is None else self._noting_run(current, present)
        return noted if noted.present == present else replace(noted, present=present)

    def _noting_run(self, current: Container, present: Mapping[str, str]) -> Update:
        if not current.alive or current.brief:
            return self
        if self.run != current.incarnation:
            begun = self.present if self.begun is None else self.begun
            content = {path: begun.get(path, digest) for path, digest in present.items()}
            return replace(self, run=current.incarnation, content=content, begun=None)
        if self.content.keys() != present.keys():
            return replace(self, content={path: self.content.get(path, digest) for path, digest in present.items()})
        return self

    def changed_content(self, container: Container, present: Mapping[str, str]) -> tuple[str, ...]:
        """Return mounted paths whose content differs from what this run has read."""
        if self.run != container.incarnation:
            return ()
        return tuple(sorted(p for p, digest in present.items() if self.content.get(p, digest) != digest))
