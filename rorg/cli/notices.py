"""What a command says on standard error above its answer, each line once: what is not in force, who does not answer.

These lines go beside the data, so that a table or JSON on standard output stays what it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rorg.cli.output import note
from rorg.cli.terminal import entry


class Notices:
    """Of one command."""

    def __init__(self) -> None:
        self.quiet = False
        """Nothing is said: a shell completes a line."""
        self._said: set[str] = set()

    def say(self, text: str) -> None:
        """Say it, unless it was said before."""
        if not self.quiet and text not in self._said:
            self._said.add(text)
            note(entry("", text))

    def of(self, view: dict[str, Any], silent: bool) -> None:
        """Say what a reader of this status must know. `silent`: that the engine does not answer was said already."""
        for text in _of(view, silent):
            self.say(text)

    def of_standing(self, view: dict[str, Any]) -> None:
        """Say that it is not known yet whether the manifests are good: for listings of services alone, since every
        change brings it about for some seconds."""
        standing = view.get("tree", {}).get("standing") or {}
        if standing.get("code") == "baking":
            self.say(f"manifests are baking: {standing['reason']}")


def _of(view: dict[str, Any], silent: bool) -> Iterator[str]:
    engine, tree = view.get("engine", {}), view.get("tree", {})
    if not (engine.get("complete", True) or silent) and view.get("pid"):
        yield f"{engine.get('error') or 'the engine has not said yet what runs'}; states may be old"
    if errors := tree.get("errors"):
        from rorg.model.units import counted

        kept = "the last good ones are in force" if tree.get("fingerprint") else "none are in force yet"
        yield f"manifests refused: {counted(len(errors), 'error')}, {kept}; try `rorg validate`"
    if error := (tree.get("git") or {}).get("error"):
        yield f"git: {error}"
    yield from view.get("requests_errors") or []
    if view.get("suspended"):
        yield f"rorg is {view['suspended']}"
    if view.get("down") == "down":
        yield "the robot is down; try `rorg up`"
