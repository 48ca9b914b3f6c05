"""The result of one attempt of a probe."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Answer:
    """Yes; no, with what was found; or (`asked` is False) no result, because the program that it asks does not
    answer. Then nothing was learned about the service."""

    ok: bool
    message: str = ""
    """For people; empty for yes."""
    asked: bool = True


YES = Answer(True)


def no(message: str) -> Answer:
    """The answer is no."""
    return Answer(False, message)


def cannot_ask(why: str) -> Answer:
    """There is no answer."""
    return Answer(False, f"cannot ask: {why}", asked=False)
