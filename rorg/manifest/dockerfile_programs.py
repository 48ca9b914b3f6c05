"""ENTRYPOINT and CMD of a Dockerfile's last stage, or of its base (Dockerfile reference, "Understand how CMD and
ENTRYPOINT interact")."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import lru_cache

from rorg.manifest.dockerfile_lines import DockerfileError, script


@dataclass(frozen=True, slots=True)
class Program:
    """One ENTRYPOINT or CMD."""

    instruction: str
    text: str
    line: int
    """From 1."""

    @property
    def by_shell(self) -> bool:
        """Whether `/bin/sh -c` runs it, because it is not a JSON list of words."""
        try:
            return not isinstance(json.loads(self.text), list)
        except (ValueError, RecursionError):
            return True


@dataclass(frozen=True, slots=True)
class Programs:
    """The programs of one image, as far as its own file declares them."""

    entrypoint: Program | None = None
    command: Program | None = None
    base_line: int = 0
    """Line of the FROM of its base, from 1; 0 if the base no longer matters."""

    def on(self, base: Programs) -> Programs:
        """Adds the entry point of its base, and the base's command unless it has an entry point itself."""
        if self.entrypoint:
            return self
        return Programs(base.entrypoint, self.command or base.command, base.base_line)


@lru_cache(maxsize=512)
def programs_of(text: str, target: str = "") -> Programs:
    """The programs of the stage that is built: the target, or the last one. Empty for a file that Docker would
    refuse."""
    try:
        instructions = script(text).instructions
    except DockerfileError:
        return Programs()
    stages: list[tuple[str, str, Programs]] = []
    for instruction in instructions:
        words = instruction.arguments.text.split()
        if instruction.name == "FROM" and words:
            name = words[2].lower() if len(words) == 3 else ""
            stages.append((name, words[0].lower(), Programs(base_line=instruction.line)))
        elif instruction.name in ("ENTRYPOINT", "CMD") and stages:
            name, base, found = stages[-1]
            said = Program(instruction.name, instruction.arguments.text.strip(), instruction.line)
            if instruction.name == "ENTRYPOINT":
                found = Programs(said, found.command)
            else:
                found = replace(found, command=said)
            stages[-1] = name, base, found
    return _whole(stages, target.lower())


def _whole(stages: list[tuple[str, str, Programs]], target: str) -> Programs:
    """Resolves a stage with the earlier stages that it is based on."""
    known: dict[str, Programs] = {}
    found = Programs()
    for name, base, own in stages:
        found = own.on(known[base]) if base in known else own
        if name:
            known[name] = found
        if target and name == target:
            break
    return found
