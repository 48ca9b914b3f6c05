"""What came of one attempt of a probe."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Answer:
    """Yes; no, with what was found; or, `asked` being False, that the question could not be put: who would have to be
    asked does not answer, and nothing was learnt of the service."""

    ok: bool
    message: str = ""
    """In words, for people; empty for yes."""
    asked: bool = True


YES = Answer(True)


def no(message: str) -> Answer:
    """It was asked, and is not so."""
    return Answer(False, message)


def cannot_ask(why: str) -> Answer:
    """Nothing was learnt."""
    return Answer(False, f"cannot ask: {why}", asked=False)
