"""What is read may ask for more than rorg takes."""

from __future__ import annotations

from rorg.model.diagnostics import Diagnostic, Where


class TooMuch(Exception):
    """Reading ends here; the diagnostic says where and why."""

    def __init__(self, where: Where, message: str, remedy: str = "a smaller project") -> None:
        super().__init__(message)
        self.diagnostic = Diagnostic(where, message, remedy)
