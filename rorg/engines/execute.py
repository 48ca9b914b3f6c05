"""Makes the engine call of an operation. Decides nothing."""

from __future__ import annotations

from rorg.core.dispatch import Outcome
from rorg.core.operations import (
    Activate,
    Create,
    CreateObject,
    Deactivate,
    ObjectOperation,
    Operation,
    Pause,
    Remove,
    Rename,
    Resume,
    Signal,
    Start,
    Stop,
    Update,
)
from rorg.core.plan import Action
from rorg.engines.protocol import Lifecycle, ManagedNodes, Objects
from rorg.errors import EngineError, RorgError, TimedOut, Unreachable, advice

NO_REFUSAL = ("gone", "conflict", "name_taken", "spent", "left_running", "no_space")
"""Kinds of errors that say nothing against what was asked: the container was in a different state than expected, or the
disk is full."""


def failure(action: Action, error: RorgError) -> Outcome:
    """The outcome of an action that failed."""
    kind = error.kind if isinstance(error, EngineError) else "no answer"
    return Outcome(
        action,
        error.why + advice(error.remedy),
        refused=kind not in (*NO_REFUSAL, "no answer"),
        missing=kind == "missing_image",
        spent=kind == "spent",
        unsupported=kind == "unsupported",
        unanswered=isinstance(error, Unreachable) and not isinstance(error, TimedOut),
    )


def perform(engine: Lifecycle, operation: Operation, nodes: ManagedNodes) -> str:
    """Make the call of an operation: of the engine, or of managed nodes of ROS 2. Return the id of the container that
    it was done to, empty if it concerns a network or a volume. Raises Unreachable and EngineError."""
    container = operation.container
    match operation:
        case Activate() | Deactivate():
            change = nodes.activate if isinstance(operation, Activate) else nodes.deactivate
            change(container, operation.domain, operation.nodes)
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
        case ObjectOperation():
            _perform_on_object(engine, operation)
        case _:
            raise AssertionError(f"no engine call for {operation}")
    return container


def _perform_on_object(engine: Lifecycle, operation: ObjectOperation) -> None:
    """Make or remove a network or volume."""
    assert isinstance(engine, Objects), "only such an engine has any"
    if isinstance(operation, CreateObject):
        engine.make_object(operation.object, operation.name, operation.spec, operation.labels)
    else:
        engine.remove_object(operation.object, operation.name)
