"""What is to be done about images, who does it, who hears of it, and what became of it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from rorg.errors import EngineError
from rorg.model.catalog import Image
from rorg.model.image_names import SHORT

LABEL_IMAGE = "rorg.io/image"
"""Label of an image of ours: which Image of a tree it is."""
LABEL_IDENTITY = "rorg.io/identity"
"""Likewise: of which content."""
LABEL_BUILDER = "rorg.io/built-by"
"""Likewise: the instance that built it. Not the label of an owner: containers have the labels of their image, and one
that a person makes of it is nobody's service."""


@dataclass(frozen=True, slots=True)
class Order:
    """One image that is to be had."""

    reference: str
    """What containers are made from: "NAME:<12 digits>", or an external reference."""
    image: Image | None = None
    """None: an external image, which is pulled."""
    also: tuple[str, ...] = ()
    """Further tags that it gets."""
    labels: Mapping[str, str] = field(default_factory=dict)
    below: tuple[str, ...] = ()
    """References of orders that must be carried out first."""
    replacements: Mapping[str, str] = field(default_factory=dict)
    """Reference in the Dockerfile -> what is put in its place: the reference of that order."""
    there: bool = False
    """It is on the machine, and wanted as it is: nothing is done."""
    pull: bool = False
    """An external image that is there is pulled all the same; where that fails it stays as it is."""
    cache: bool = True
    """What the engine has kept of earlier builds may be used."""
    unchanged: Callable[[], bool] = field(default=lambda: True, compare=False)
    """Asked once it is made: whether what it was made from is still what its reference means."""

    @property
    def name(self) -> str:
        """That of the Image, or the reference: for people."""
        return self.image.name if self.image else self.reference

    @property
    def log_name(self) -> tuple[str, str]:
        """(what the names of its logs begin with, what tells this content's from others)."""
        stem = self.name.replace("/", "-").replace(":", "-")
        return stem, self.labels.get(LABEL_IDENTITY, "")[:SHORT] or "latest"


@dataclass(frozen=True, slots=True)
class Result:
    """What became of an order."""

    reference: str
    outcome: str
    """built, imported, pulled, present, failed or skipped."""
    message: str = ""
    """Why it failed or was skipped, or could not be pulled anew; one line."""
    step: str = ""
    """The instruction that failed, as the engine says it: "Step 3/7 : COPY nothing /x"."""
    log: str = ""
    """The file with all that was said; empty where there is none."""
    seconds: float = 0.0
    id: str = ""
    """What the engine calls it: the id of what was built or imported, the digest of what was pulled. Empty where
    nothing was done."""

    @property
    def good(self) -> bool:
        return self.outcome not in ("failed", "skipped")


class StepFailed(EngineError):
    """A build that failed at an instruction."""

    def __init__(self, what: str, why: str, step: str) -> None:
        super().__init__(what, why)
        self.step = step


class Say(Protocol):
    """Where all goes that is said while an image comes to be. `step`: it is what is being done, for people to see."""

    def __call__(self, text: str, step: bool = False) -> None: ...


class Builder(Protocol):
    """Where images come to be. Used by one thread, but for cancel(). Everything raises RorgError; build() and load()
    OSError too, for what cannot be read."""

    def there(self, references: Collection[str]) -> set[str]:
        """Those of them that the engine has: one call."""
        ...

    def pull(self, reference: str, say: Say) -> None: ...

    def build(self, order: Order, say: Say) -> str:
        """Builds an image with a context, labelled, tagged with the order's reference; its id. Raises StepFailed."""
        ...

    def load(self, order: Order, say: Say) -> str:
        """The same of an image that is imported. Nothing is tagged where the command fails."""
        ...

    def tag(self, reference: str, also: str) -> None: ...

    def remove(self, references: Collection[str]) -> None:
        """Takes images away again; one that something still uses stays."""
        ...

    def digest(self, reference: str) -> str:
        """Of what was pulled, as its registry has it; else the id."""
        ...

    def cancel(self) -> None:
        """Ends what is under way, from any thread, and whatever is asked for later: both fail."""
        ...

    def close(self) -> None: ...


class Listener(Protocol):
    """Hears of a build as it goes on: from several threads, one at a time."""

    def began(self, order: Order) -> None: ...
    def step(self, order: Order, text: str) -> None: ...
    def ended(self, result: Result) -> None: ...
