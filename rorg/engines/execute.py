"""Performs one operation as one call of the engine. Decides nothing."""

from __future__ import annotations

from rorg.core.operations import (
    Create,
    CreateObject,
    Operation,
    Pause,
    Remove,
    RemoveObject,
    Rename,
    Resume,
    Signal,
    Start,
    Stop,
    Update,
)
from rorg.core.outcomes import Outcome
from rorg.core.plan import Action
from rorg.engines.protocol import Lifecycle, Objects
from rorg.errors import EngineError, RorgError

STATE = ("gone", "conflict", "name_taken", "spent", "left_running")
"""Kinds of errors that tell of another state than was thought."""


def said_no(error: RorgError) -> bool:
    """Whether the engine refused what was asked; not that it gave no answer, or found another state than it thought."""
    return isinstance(error, EngineError) and error.kind not in STATE


def is_missing(error: RorgError) -> bool:
    """Whether the image, or the program, that was to be run is not on this machine."""
    return isinstance(error, EngineError) and error.kind == "missing_image"


def is_spent(error: RorgError) -> bool:
    """Whether the engine will never start that container again, though nothing is wrong with what it is made from."""
    return isinstance(error, EngineError) and error.kind == "spent"


def is_unsupported(error: RorgError) -> bool:
    """Whether the engine lacks what was asked for, so that trying again does not help."""
    return isinstance(error, EngineError) and error.kind == "unsupported"


def failure(action: Action, error: RorgError) -> Outcome:
    """What came of an action that failed."""
    return Outcome(
        action,
        error.why + (f"; try {error.remedy}" if error.remedy else ""),
        said_no(error),
        is_missing(error),
        is_spent(error),
        is_unsupported(error),
    )


def perform(engine: Lifecycle, operation: Operation) -> str:
    """Make the engine call of an operation. Return the id of the container that it was done to, empty if it concerns a
    network or a volume. Raises Unreachable and EngineError."""
    container = operation.container
    match operation:
        case Create():
            return engine.create(operation.name, operation.spec, operation.labels, operation.before, operation.defaults)
        case Start():
            engine.start(container)
        case Resume():
            engine.resume(container)
        case Pause():
            engine.pause(container)
        case Stop():
            engine.stop(container, operation.signal, operation.grace)
        case Signal():
            engine.signal(container, operation.signal)
        case Remove():
            engine.remove(container, operation.volumes)
        case Rename():
            engine.rename(container, operation.name)
        case Update():
            engine.update(container, operation.options)
        case CreateObject() if isinstance(engine, Objects):
            engine.make_object(operation.object, operation.name, operation.spec, operation.labels)
        case RemoveObject() if isinstance(engine, Objects):
            engine.remove_object(operation.object, operation.name)
        case _:
            raise AssertionError(f"no engine call for {operation}")
    return container
