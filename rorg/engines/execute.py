"""Performs one action as one call of the engine. Carries no decision."""

from __future__ import annotations

from rorg.core.plan import Action
from rorg.engines.protocol import Lifecycle, Objects
from rorg.errors import EngineError, RorgError
from rorg.model.objects import is_object

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


def perform(engine: Lifecycle, action: Action) -> str:
    """Does what the action says and returns the id of the container that it was done to."""
    args = action.args
    if is_object(action.service):
        return _perform_on_object(engine, action)
    match action.verb:
        case "create":
            return engine.create(
                args["name"], args["spec"], args["labels"], args.get("before", ""), args.get("defaults", ())
            )
        case "start":
            engine.start(action.container)
        case "resume":
            engine.resume(action.container)
        case "pause":
            engine.pause(action.container)
        case "stop":
            engine.stop(action.container, args["signal"], args["grace"])
        case "signal":
            engine.signal(action.container, args["signal"])
        case "remove":
            engine.remove(action.container, args.get("volumes", False))
        case "rename":
            engine.rename(action.container, args["name"])
        case "update":
            engine.update(action.container, args["options"])
        case _:
            raise AssertionError(f"no such verb: {action.verb}")
    return action.container


def _perform_on_object(engine: Lifecycle, action: Action) -> str:
    """The same of a network or volume; no container is touched, so there is no id."""
    args = action.args
    assert isinstance(engine, Objects)
    if action.verb == "create":
        engine.make_object(args["object"], args["name"], args["spec"], args["labels"])
    else:
        engine.remove_object(args["object"], args["name"])
    return ""
