"""Orders for images: what to do, who does it, who listens, and the result."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from rorg.errors import EngineError
from rorg.model.catalog import Image
from rorg.model.image_names import SHORT

LABEL_IMAGE = "rorg.io/image"
"""Label of rorg's images: the Image in a tree."""
LABEL_IDENTITY = "rorg.io/identity"
"""Label of rorg's images: their content."""
LABEL_BUILDER = "rorg.io/built-by"
"""Label of rorg's images: the instance that built them. It is not the owner's label: containers inherit labels from
their image, and one that a person creates from it does not belong to a service."""


@dataclass(frozen=True, slots=True)
class Order:
    """One image to get."""

    reference: str
    """The reference that containers use: "NAME:<12 digits>", or an external reference."""
    image: Image | None = None
    """None for an external image, which is pulled."""
    also: tuple[str, ...] = ()
    """Additional tags."""
    labels: Mapping[str, str] = field(default_factory=dict)
    below: tuple[str, ...] = ()
    """References of orders that must be carried out first."""
    replacements: Mapping[str, str] = field(default_factory=dict)
    """Reference in the Dockerfile -> its replacement: the reference of that order."""
    there: bool = False
    """The image exists and is wanted as it is, so nothing is done."""
    pull: bool = False
    """Pull an external image although it exists; if that fails, the existing one stays."""
    cache: bool = True
    """Whether results of earlier builds in the engine's cache may be used."""
    unchanged: Callable[[], bool] = field(default=lambda: True, compare=False)
    """Asked after the build: whether the files still are what the reference means."""

    @property
    def name(self) -> str:
        """The name of the Image, or the reference; for people."""
        return self.image.name if self.image else self.reference

    @property
    def log_name(self) -> tuple[str, str]:
        """(prefix of its logs' names, what distinguishes this content from others)."""
        stem = self.name.replace("/", "-").replace(":", "-")
        return stem, self.labels.get(LABEL_IDENTITY, "")[:SHORT] or "latest"


@dataclass(frozen=True, slots=True)
class Result:
    """The result of an order."""

    reference: str
    outcome: str
    """built, imported, pulled, present, failed or skipped."""
    message: str = ""
    """Why it failed, was skipped, or could not be pulled again; one line."""
    step: str = ""
    """The instruction that failed, in the engine's words: "Step 3/7 : COPY nothing /x"."""
    log: str = ""
    """The file with the full log; empty if there is none."""
    seconds: float = 0.0
    id: str = ""
    """The engine's name: the id of a built or imported image, the digest of a pulled one. Empty if nothing was
    done."""

    @property
    def good(self) -> bool:
        return self.outcome not in ("failed", "skipped")


class StepFailed(EngineError):
    """A build failed at an instruction."""

    def __init__(self, what: str, why: str, step: str) -> None:
        super().__init__(what, why)
        self.step = step


class Say(Protocol):
    """Receives all output while an image is made. `step`: the text is the current instruction, to be shown to
    people."""

    def __call__(self, text: str, step: bool = False) -> None: ...


class Builder(Protocol):
    """Makes images. Used by one thread, except for cancel(). Every method raises RorgError; build() and load() also
    raise OSError for unreadable files."""

    def there(self, references: Collection[str]) -> set[str]:
        """The references that the engine has, with a single call."""
        ...

    def pull(self, reference: str, say: Say) -> None: ...

    def build(self, order: Order, say: Say) -> str:
        """Builds an image with a context, labels it and tags it with the order's reference; its id. Raises
        StepFailed."""
        ...

    def load(self, order: Order, say: Say) -> str:
        """The same for an imported image. Nothing is tagged if the command fails."""
        ...

    def tag(self, reference: str, also: str) -> None: ...

    def remove(self, references: Collection[str]) -> None:
        """Removes images, except those still in use."""
        ...

    def digest(self, reference: str) -> str:
        """The digest of a pulled image in its registry; otherwise the id."""
        ...

    def cancel(self) -> None:
        """Makes everything under way, and everything asked for later, fail. Any thread may call it."""
        ...

    def close(self) -> None: ...


class Listener(Protocol):
    """Is told about a build as it proceeds: from several threads, one at a time."""

    def began(self, order: Order) -> None: ...
    def step(self, order: Order, text: str) -> None: ...
    def ended(self, result: Result) -> None: ...
