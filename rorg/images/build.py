"""Carries out orders for images: parents before children, independent ones in parallel. A failure stops only the images
that are based on the failed one."""

from __future__ import annotations

import contextlib
import os
import re
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from rorg.core.masking import forms, hidden
from rorg.errors import EngineError, Invalid, RorgError
from rorg.images.order import Builder, Listener, Order, Result, Say
from rorg.model.image_names import SHORT
from rorg.store.files import make_directory, regular

TURN = 0.2
"""Seconds until a build ends after its `stop` is set."""
STOPPED = "stopped"
"""The message of orders that were ended or not begun because the caller no longer wants them."""
SHORTEST = 4
"""Least length of a build argument that is hidden; shorter ones are not secrets, and occur in any text."""


def build(
    orders: Sequence[Order],
    make_builder: Callable[[], Builder],
    *,
    jobs: int,
    clock: Callable[[], float],
    listener: Listener,
    stop: threading.Event | None = None,
    logs: Path | None = None,
) -> list[Result]:
    """Carries out all orders, `jobs` of them in parallel, each worker with its own builder. Results are in the order of
    `orders`. `clock`: in seconds; `logs`: folder for the logs of builds. Once `stop` is set, nothing more begins, and
    running builds are ended. Raises Invalid if images are based on each other in a cycle."""
    known = {order.reference: order for order in orders}
    sorter = TopologicalSorter({reference: [b for b in o.below if b in known] for reference, o in known.items()})
    try:
        sorter.prepare()
    except CycleError as error:
        cycle = " -> ".join(error.args[1])
        raise Invalid("build", f"images are based on each other: {cycle}", "to break the cycle") from error
    most = min(jobs, sum(not _is_present(order) for order in known.values()))
    return _Build(known, make_builder, clock, listener, stop or threading.Event(), logs).run(sorter, max(1, most))


@dataclass
class _Build:
    """The calling thread decides what comes next; the workers do it."""

    orders: Mapping[str, Order]
    make_builder: Callable[[], Builder]
    clock: Callable[[], float]
    listener: Listener
    stop: threading.Event
    logs: Path | None
    cancelled: threading.Event = field(default_factory=threading.Event)
    hearing: threading.Lock = field(default_factory=threading.Lock)
    results: dict[str, Result] = field(default_factory=dict)
    builders: list[Builder] = field(default_factory=list)
    own: threading.local = field(default_factory=threading.local)
    """The builder of each worker."""

    def run(self, sorter: TopologicalSorter[str], jobs: int) -> list[Result]:
        pool = ThreadPoolExecutor(jobs, "build")
        try:
            self._go_through(sorter, pool)
        finally:
            if len(self.results) < len(self.orders):  # the caller was interrupted
                self._cancel()
            pool.shutdown(cancel_futures=True)
            for builder in self.builders:
                builder.close()
        return [self.results[reference] for reference in self.orders]

    def _go_through(self, sorter: TopologicalSorter[str], pool: Executor) -> None:
        running = set[Future[Result]]()
        while sorter.is_active():
            ended = []
            for order in map(self.orders.__getitem__, sorter.get_ready()):
                if result := self._without_work(order):
                    self._tell_end(result)
                    ended.append(result)
                else:
                    running.add(pool.submit(self._work, order))
            if not ended:
                done, running = wait(running, TURN, FIRST_COMPLETED)
                ended = [future.result() for future in done]
            if self.stop.is_set():
                self._cancel()
            for result in ended:
                self.results[result.reference] = result
                sorter.done(result.reference)

    def _without_work(self, order: Order) -> Result | None:
        """The result of an order that needs no work; None if it does."""
        if _is_present(order):
            return Result(order.reference, "present")
        if self._stopping():
            return Result(order.reference, "skipped", STOPPED)
        for reference in order.below:
            below = self.results.get(reference)
            if below and not below.good:
                failed = below.outcome == "failed" and below.message != STOPPED
                why = f"{self.orders[reference].name} failed" if failed else below.message
                return Result(order.reference, "skipped", why)
        return None

    def _stopping(self) -> bool:
        return self.stop.is_set() or self.cancelled.is_set()

    def _cancel(self) -> None:
        """Ends running orders. A worker that is just making its builder checks this itself."""
        if not self.cancelled.is_set():
            self.cancelled.set()
            for builder in list(self.builders):
                builder.cancel()

    def _tell_end(self, result: Result) -> None:
        with self.hearing:
            self.listener.ended(result)

    # -- the workers -------------------------------------------------------------------------------------------

    def _work(self, order: Order) -> Result:
        began = self.clock()
        try:
            result = self._carry_out(order, self._builder())
        except BaseException as error:  # the caller waits for a result in every case
            result = self._failure(order, error)
        result = replace(result, seconds=self.clock() - began)
        try:
            self._tell_end(result)
        except BaseException as error:
            result = self._failure(order, error)
        return result

    def _builder(self) -> Builder:
        """The builder of this worker."""
        if not hasattr(self.own, "builder"):
            self.own.builder = self.make_builder()
            self.builders.append(self.own.builder)
            if self.cancelled.is_set():
                self.own.builder.cancel()
        builder: Builder = self.own.builder
        return builder

    def _carry_out(self, order: Order, builder: Builder) -> Result:
        """The result of an order. Raises what the builder raises."""
        if self._stopping():
            return Result(order.reference, "skipped", STOPPED)
        with self.hearing:
            self.listener.began(order)
        if order.image is None:
            return _pulled(order, builder, self._telling(order, None))
        with build_log(self.logs, order) as log:
            say = self._telling(order, log)
            try:
                return replace(_made(order, builder, say), log=log_path(self.logs, order))
            except BaseException as error:
                log(_hidden(str(error), order))
                raise

    def _telling(self, order: Order, log: Callable[[str], None] | None) -> Say:
        def say(text: str, step: bool = False) -> None:
            if log:
                log(_hidden(text, order))
            if step:
                with self.hearing:
                    self.listener.step(order, _shown(text, order))

        return say

    def _failure(self, order: Order, error: BaseException) -> Result:
        if self._stopping():
            why = STOPPED
        elif isinstance(error, RorgError):
            why = error.why
        elif isinstance(error, OSError):
            why = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        else:
            why = f"internal error: {type(error).__name__}: {error}"
        step = _shown(getattr(error, "step", ""), order)
        log = log_path(self.logs, order) if order.image else ""
        return Result(order.reference, "failed", _shown(why, order), step, log)


def _is_present(order: Order) -> bool:
    return order.there and not order.pull


def _pulled(order: Order, builder: Builder, say: Say) -> Result:
    try:
        builder.pull(order.reference, say)
    except RorgError as error:
        if not order.there:
            raise
        return Result(order.reference, "present", f"the old one stays, because it cannot be pulled: {error.why}")
    return Result(order.reference, "pulled", id=builder.digest(order.reference))


def _made(order: Order, builder: Builder, say: Say) -> Result:
    assert order.image is not None
    imported = order.image.import_command is not None
    made = builder.load(order, say) if imported else builder.build(order, say)
    if not order.unchanged():
        builder.remove([order.reference])
        raise EngineError(f"build {order.name}", "its files changed while it was being built", "again")
    for name in order.also:
        builder.tag(order.reference, name)
    return Result(order.reference, "imported" if imported else "built", id=made)


def _shown(text: str, order: Order) -> str:
    """The text on one line, without the values of build arguments."""
    values = {value for value in (order.image.args.values() if order.image else ()) if len(value) >= SHORTEST}
    return " ".join(hidden(_hidden(text, order), sorted(values, key=len, reverse=True)).split())


def _hidden(text: str, order: Order) -> str:
    """The text without secret build arguments, for the log."""
    return hidden(text, forms(order.image.args[name] for name in order.image.secrets)) if order.image else text


KEPT = 5
"""Logs kept for each image."""
PRIVATE = 0o600
"""Mode of the logs, because build arguments may be secrets."""


@contextlib.contextmanager
def build_log(folder: Path | None, order: Order) -> Iterator[Callable[[str], None]]:
    """Opens the log of a build and returns a function that writes to it; discards everything if there is no folder.
    Raises OSError."""
    if folder is None:
        with open(os.devnull, "w") as nothing:
            yield lambda text: print(text, file=nothing)
        return
    make_directory(folder, 0o700)
    descriptor = regular(Path(log_path(folder, order)), os.O_WRONLY | os.O_CREAT)
    os.fchmod(descriptor, PRIVATE)
    os.ftruncate(descriptor, 0)
    with open(descriptor, "w", encoding="utf-8", errors="replace", buffering=1) as file:
        _remove_old(folder, order.log_name[0])
        yield lambda text: print(text, file=file, end="" if text.endswith("\n") else "\n")


def log_path(folder: Path | None, order: Order) -> str:
    """The path of an order's log; empty if there is no folder."""
    stem, identity = order.log_name
    return str(folder / f"{stem}-{identity}.log") if folder else ""


def _remove_old(folder: Path, stem: str) -> None:
    name = re.compile(rf"{re.escape(stem)}-(latest|[0-9a-f]{{{SHORT}}})\.log")
    logs = sorted((p for p in folder.iterdir() if name.fullmatch(p.name)), key=lambda p: p.stat().st_mtime_ns)
    for path in logs[:-KEPT]:
        path.unlink(missing_ok=True)
