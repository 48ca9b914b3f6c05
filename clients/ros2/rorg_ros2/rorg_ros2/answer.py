"""The answer to one order of rorg."""

from __future__ import annotations

from typing import Any, NamedTuple

# Characters of a message that rorg takes.
MOST = 1000


class Answer(NamedTuple):
    """`asked` is False if nothing was learned."""

    ok: bool
    message: str = ''
    asked: bool = True

    def as_json(self) -> dict[str, Any]:
        return {'ok': self.ok, 'message': self.message[:MOST], 'asked': self.asked}
