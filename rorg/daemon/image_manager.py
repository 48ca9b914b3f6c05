"""Builds or pulls missing images beside the loop, which goes on meanwhile. A running container is not touched before
its new image exists."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping

from rorg.core.desired import Desired
from rorg.core.situation import MissingImage
from rorg.daemon.recorder import Recorder
from rorg.engines.protocol import Images
from rorg.errors import RorgError, Unreachable
from rorg.images.build import STOPPED
from rorg.images.order import Order, Result
from rorg.images.references import Content
from rorg.images.supply import Supplier
from rorg.model.catalog import Catalog
from rorg.model.policy import ImagePolicy

PATIENCE = 1.0
"""Seconds that the end of the loop waits for a build to end."""
SOON = 1.0
"""Seconds until an engine that does not answer is asked again."""
AGAIN, MOST = 30.0, 3600.0
"""Seconds until a failed image is tried again; twice as long each time, up to MOST."""
UNCHECKED = MissingImage()
NOTHING: Mapping[str, MissingImage] = {}


class ImageManager:
    """Works in a thread of its own. `wake` is called when something new is known."""

    def __init__(self, engine: Images, supplier: Supplier, recorder: Recorder, wake: Callable[[], None]) -> None:
        self.engine, self.supplier, self.recorder, self.wake = engine, supplier, recorder, wake
        self.records = supplier.records
        self._changed = threading.Condition()
        self._halt = threading.Event()
        """Set when the images that are being made are no longer wanted."""
        self._desired: Desired | None = None
        self._content = Content()
        self._policy = ImagePolicy()
        self._asked = self._busy = self._stopping = False
        self._records: tuple[int, ...] = ()
        """The stamp of the record of builds at the last look."""
        self._there: set[str] = set()
        self._missing: Mapping[str, MissingImage] = NOTHING
        self._failures = 0
        """Attempts in a row in which something failed."""
        self._pause: float | None = None
        """Seconds until the next attempt; None if there is none."""
        self._thread = threading.Thread(target=self._run, name="images", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        with self._changed:
            self._stopping = True
            self._halt.set()
            self._changed.notify()
            busy = self._busy
        if busy:  # a build ends with this process
            self._thread.join(PATIENCE)

    def look(self, desired: Desired, content: Content) -> Mapping[str, MissingImage]:
        """Reference -> why nothing can be made from it now. Never asks the engine: what is not known to exist is looked
        for in the background."""
        with self._changed:
            if desired is not self._desired:
                self._adopt(desired, content)
            if self._missing and not self._busy and self.records.stamp != self._records:
                self._records = self.records.stamp
                self._ask()
            return self._missing

    def _adopt(self, desired: Desired, content: Content) -> None:
        same = self._desired is not None and used(desired) == used(self._desired) and content == self._content
        self._desired, self._content = desired, content
        if same and desired.catalog.policy.images == self._policy:
            return
        self._failures, self._policy = 0, desired.catalog.policy.images
        wanted = used(desired)
        self._missing = {r: self._missing.get(r, UNCHECKED) for r in sorted(wanted - self._there)}
        # If nothing is missing, this records which images the current manifests use.
        self._ask()

    def check(self) -> None:
        """Look for all wanted images again: someone built, pulled or removed some."""
        with self._changed:
            self._there.clear()
            self._failures = 0
            self._ask()

    def _ask(self) -> None:
        self._asked = True
        self._halt.set()
        self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._asked or self._stopping, self._pause)
                if self._stopping:
                    return
                self._asked = False
                self._halt.clear()
                desired, content, self._busy = self._desired, self._content, True
            if desired is not None:
                self._have(desired, content)
            with self._changed:
                self._records, self._busy = self.records.stamp, False

    def _have(self, desired: Desired, content: Content) -> None:
        wanted = used(desired)
        try:
            missing = self.engine.missing_images(wanted)
            self._found(wanted - missing, missing, desired, content)
            reasons = {r: _reason(r, desired.catalog, content) for r in missing}
            names = sorted(content.named(r) for r, reason in reasons.items() if not reason.failed)
            if names:
                self.supplier.supply(desired.catalog, content, names, listener=self, stop=self._halt)
            self._over(any(m.failed for m in self._missing.values()))
            if not self._missing and not self._asked:
                self.records.use(content.references.values())
        except Unreachable:
            self._pause = SOON
        except (RorgError, OSError) as error:
            self._failed(str(error))
        except Exception as bug:  # the loop goes on, with the images that exist
            self._failed(f"internal error: {type(bug).__name__}: {bug}")

    def _found(self, there: set[str], missing: set[str], desired: Desired, content: Content) -> None:
        with self._changed:
            self._there |= there
            if desired is not self._desired:
                return
            before = self._missing
            self._missing = {r: _reason(r, desired.catalog, content) for r in sorted(missing)}
        if before != self._missing:
            self.wake()

    def began(self, order: Order) -> None: ...
    def step(self, order: Order, text: str) -> None: ...

    def ended(self, result: Result) -> None:
        """Handle the result of a wanted image, or of one that it is built on."""
        had, reference = result.good, result.reference
        if result.message == STOPPED:  # no longer wanted, or rorg ends
            return
        with self._changed:
            reason = "" if had else why(result, self._content.named(reference) == reference)
            if had:
                self._there.add(reference)
            if reference in self._missing:
                rest = {r: m for r, m in self._missing.items() if r != reference}
                self._missing = rest if had else {**rest, reference: MissingImage(reason, failed=True)}
        if result.outcome != "present":
            self._tell(result, reason)
        self.wake()

    def _tell(self, result: Result, reason: str) -> None:
        kind, reference = "image-ready" if result.good else "image-failed", result.reference
        self.recorder.event(
            kind,
            f"image {reference} " + (reason or f"{result.outcome} in {result.seconds:.1f} s"),
            image=reference,
            outcome=result.outcome,
            seconds=round(result.seconds, 3),
        )

    def _over(self, failed: bool) -> None:
        self._failures = self._failures + 1 if failed else 0
        self._pause = min(MOST, AGAIN * 2 ** (self._failures - 1)) if failed else None

    def _failed(self, text: str) -> None:
        self._over(True)
        with self._changed:
            self._missing = {r: MissingImage(f"is not available: {text}", failed=True) for r in self._missing}
        self.wake()


def _reason(reference: str, catalog: Catalog, content: Content) -> MissingImage:
    """What happens about a missing image. An import runs a command on this machine, so a person must start it."""
    policy, image = catalog.policy.images, catalog.images.get(content.named(reference))
    if image is None and policy.pull == "never":
        return MissingImage(
            "is not on this machine, and the Policy does not allow to pull it; try `docker pull`", failed=True
        )
    if image is None:
        return MissingImage("is being pulled")
    if image.import_command is not None or policy.build == "never":
        return MissingImage(f"is not on this machine; try `rorg build {image.name}`", failed=True)
    return MissingImage("is being built")


def why(result: Result, external: bool) -> str:
    """Why an image is missing, in words."""
    if result.outcome == "skipped":
        return f"is not built: {result.message}"
    if external:
        return f"is not on this machine, and cannot be pulled: {result.message}"
    return f"cannot be built{' at ' + result.step if result.step else ''}: {result.message}"


def used(desired: Desired) -> set[str]:
    """References that services are made from."""
    return {str(s.spec["image"]) for s in desired.catalog.services.values() if s.spec is not None and "image" in s.spec}
