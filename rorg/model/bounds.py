"""The error for input that is larger than rorg accepts."""

from __future__ import annotations

from rorg.model.diagnostics import Diagnostic, Where


class TooMuch(Exception):
    """Reading stops; the diagnostic has the place and the reason."""

    def __init__(self, where: Where, message: str, remedy: str = "a smaller project") -> None:
        super().__init__(message)
        self.diagnostic = Diagnostic(where, message, remedy)
