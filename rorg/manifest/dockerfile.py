"""Finds the images that a Dockerfile uses, and rewrites their references.

`FROM`, `COPY --from` and `RUN --mount=...,from=` use references. Docker fills in variables only in FROM, and only those
of the platform and of ARG lines before the first FROM. ARG and ENV inside a stage therefore do not matter here; Docker
and `read` refuse variables in the other two places. ONBUILD affects builds of other images, not this one. ADD has no
`--from`. Mistakes that change no reference are left for Docker to refuse.

If versions of Docker differ, this file follows the current BuildKit: an ARG that is declared again without a value
keeps its value (20.10 empties it), and COPY also finds later stages (Docker's first builder takes them for images).
"""

from __future__ import annotations

import re
from bisect import bisect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from rorg.manifest.dockerfile_lines import WORD, DockerfileError, Instruction, Script, Token, script
from rorg.manifest.dockerfile_programs import Program, Programs
from rorg.manifest.dockerfile_words import BadWord, Lexer

__all__ = ["Dockerfile", "DockerfileError", "Use", "read", "rewritten"]

MACHINE = "linux/amd64"
NO_IMAGE = "scratch"
CLASSIC_FLAGS = {"RUN": set[str](), "COPY": {"--from", "--chown"}, "ADD": {"--chown"}}
"""Flags that Docker's first builder knows; every other flag of these instructions needs BuildKit."""
STAGE_NAME = re.compile(r"[a-z][a-z0-9\-_.]*")
INDEX = re.compile(r"[+-]?[0-9]{1,18}")
ARCHITECTURES = {"x86_64": "amd64", "x86-64": "amd64", "aarch64": "arm64", "i386": "386", "armhf": "arm"}


@dataclass(frozen=True, slots=True)
class Use:
    """One place that names an image, neither a stage of the file nor scratch."""

    reference: str
    """With build arguments filled in."""
    by: str
    """FROM, COPY or RUN."""
    line: int
    """Line of the reference, from 1."""
    places: tuple[int, int] = field(default=(0, 0), compare=False)
    """Start and end of its text in the file, in characters."""
    quotes: str = field(default="", compare=False)
    """Quotes that must follow a replacement, so that quotes which begin or end inside the reference stay paired."""


@dataclass(frozen=True, slots=True)
class Dockerfile:
    """The images and stages of a file."""

    uses: tuple[Use, ...]
    """In order of appearance."""
    stages: tuple[str, ...]
    """Names of the stages that are built, as written; "" for a nameless one."""
    buildkit: bool
    """Docker's first builder cannot build it correctly: it has BuildKit flags (RUN --mount, COPY --link), heredocs, a
    `# syntax=` line, platform arguments in FROM, or copies from a later stage."""
    arguments: frozenset[str] = frozenset()
    """Names of its ARG lines."""
    programs: Programs = Programs()
    """The programs of the stage that is built: the target, or the last one."""


@dataclass(frozen=True, slots=True)
class _Stage:
    name: str
    base: Token
    platform: Token | None
    line: int
    sources: list[tuple[str, Token]]
    """(COPY or RUN, text) of each source that they name."""
    programs: dict[str, Program]
    """By instruction."""


def read(
    text: str, args: Mapping[str, str], target: str = "", platform: str = "", machine: str = MACHINE
) -> Dockerfile:
    """Reads a Dockerfile.

    Keeps all stages up to the target, even those it does not need, because Docker's first builder builds them all.
    Drops later stages unless an earlier one copies from them. `platform` is the platform of the image
    (os/architecture[/variant]); empty means that of the machine. Raises DockerfileError if Docker would refuse the file
    before it looks at any image.
    """
    return _Reading(script(text), text, args, target, platform or machine, machine).result()


def rewritten(
    text: str,
    args: Mapping[str, str],
    replacements: Mapping[str, str],
    target: str = "",
    platform: str = "",
    machine: str = MACHINE,
) -> str:
    """Replaces the references that are keys of `replacements`; every other character stays. Raises DockerfileError."""
    pieces, at = [], 0
    for use in read(text, args, target, platform, machine).uses:
        if use.reference in replacements:
            start, end = use.places
            pieces += [text[at:start], replacements[use.reference], use.quotes]
            at = end
    return "".join([*pieces, text[at:]])


class _Reading:
    def __init__(
        self, file: Script, text: str, args: Mapping[str, str], target: str, platform: str, machine: str
    ) -> None:
        self.file, self.args, self.target = file, args, target
        self.ends = [match.start() for match in re.finditer("\n", text)]
        self.given = {**_platform_arguments("BUILD", machine), **_platform_arguments("TARGET", platform)}
        self.values = {name: args.get(name, value) for name, value in self.given.items()}
        self.buildkit = file.syntax or any(_of_buildkit(i) for i in file.instructions)
        self.stages = self._stages()
        self.first = {stage.name.lower(): at for at, stage in reversed(list(enumerate(self.stages)))}

    def result(self) -> Dockerfile:
        wanted = last = self._last()
        seen: dict[str, int] = {}
        uses: list[Use] = []
        programs: list[Programs] = []
        for at, stage in enumerate(self.stages):
            if at > last:
                break
            base = self._filled(stage.base, stage.line)
            if stage.platform:
                self._filled(stage.platform, stage.line)
            if not base:
                raise self._error(f"base name ({stage.base.text}) should not be blank", stage.base)
            if base != NO_IMAGE and base.lower() not in seen:
                uses.append(self._use(base, "FROM", stage.base))
            under = programs[seen[base.lower()]] if base.lower() in seen else Programs(base=base)
            programs.append(Programs(stage.programs.get("ENTRYPOINT"), stage.programs.get("CMD")).on(under))
            for by, token in stage.sources:
                source = self._source(by, token, at, seen)
                if source is None:
                    uses.append(self._use(token.text, by, token))
                else:
                    last = max(last, source)
                    self.buildkit |= source > at
            if stage.name:
                seen[stage.name.lower()] = at
        stages = tuple(stage.name for stage in self.stages[: last + 1])
        return Dockerfile(tuple(uses), stages, self.buildkit, frozenset(self._arguments()), programs[wanted])

    def _arguments(self) -> Iterator[str]:
        for instruction in self.file.instructions:
            if instruction.name == "ARG":
                words = _quoted_words(instruction.arguments.text, self.file.escape)
                yield from (word.partition("=")[0] for word in words)

    def _stages(self) -> list[_Stage]:
        stages: list[_Stage] = []
        for instruction in self.file.instructions:
            if instruction.name == "FROM":
                stages.append(_stage(instruction))
            elif stages:
                stages[-1].sources.extend((instruction.name, token) for token in _sources(instruction))
                if instruction.name in ("ENTRYPOINT", "CMD"):
                    stages[-1].programs[instruction.name] = Program(
                        instruction.name, instruction.arguments.text.strip()
                    )
            elif instruction.name == "ARG":
                self._argument(instruction)
            else:
                raise DockerfileError(f"{instruction.name[:40]} before the first FROM", instruction.line)
        if not stages:
            raise DockerfileError("it has no FROM", 1)
        return stages

    def _last(self) -> int:
        if not self.target:
            return len(self.stages) - 1
        if self.target.lower() not in self.first:
            raise DockerfileError(f"target stage {self.target} could not be found", self.stages[-1].line)
        return self.first[self.target.lower()]

    def _argument(self, instruction: Instruction) -> None:
        for word in _quoted_words(instruction.arguments.text, self.file.escape):
            name, sign, default = word.partition("=")
            if name in self.args:
                self.values[name] = self.args[name]
            elif sign and name:
                self.values[name] = self._expanded(default, instruction.line)
            else:
                continue
            self.given.pop(name, None)

    def _filled(self, token: Token, line: int) -> str:
        return self._expanded(token.text, self._line(token) if token.places else line)

    def _expanded(self, text: str, line: int) -> str:
        lexer = Lexer(text, self.values, self.file.escape)
        try:
            filled = lexer.filled()
        except BadWord as error:
            raise DockerfileError(f"{error}, in {text}", line) from error
        self.buildkit |= not lexer.used.isdisjoint(self.given)
        return filled

    def _source(self, by: str, token: Token, at: int, seen: Mapping[str, int]) -> int | None:
        """The index of the stage that COPY or RUN names, -1 for scratch, None for an image. Only BuildKit knows later
        stages; no builder lets a stage copy from itself. RUN does not accept numbers."""
        if re.search(r"\$.", token.text):
            why = f"{by} takes no variable in {token.text}: Docker fills in those of FROM only"
            raise self._error(f"{why}; name a stage by FROM {token.text} AS NAME", token)
        name = token.text.lower()
        if token.text == NO_IMAGE:
            return -1
        if by == "COPY" and INDEX.fullmatch(name):
            index: int | None = int(name)
            if not 0 <= int(name) < len(self.stages):
                raise self._error(f"invalid stage index {token.text}", token)
        else:
            index = seen.get(name, self.first.get(name))
        if index == at:
            raise self._error(f"{by} refers to its own stage {token.text}", token)
        return index

    def _line(self, token: Token) -> int:
        return bisect(self.ends, token.places[0]) + 1

    def _error(self, message: str, token: Token) -> DockerfileError:
        return DockerfileError(message, self._line(token))

    def _use(self, reference: str, by: str, token: Token) -> Use:
        quotes = (*token.quotes[:1], *token.quotes[-1:])
        pairs = "".join(quotes) if len(set(quotes)) > 1 else ""
        return Use(reference, by, self._line(token), (token.places[0], token.places[-1] + 1), pairs)


def _stage(instruction: Instruction) -> _Stage:
    matches = [match for match in WORD.finditer(instruction.arguments.text) if match[0]]
    words = [instruction.arguments.part(*match.span()) for match in matches]
    if len(words) not in (1, 3) or (len(words) == 3 and words[1].text.lower() != "as"):
        raise DockerfileError("FROM requires either one or three arguments", instruction.line)
    name = words[2].text if len(words) == 3 else ""
    if name and not STAGE_NAME.fullmatch(name.lower()):
        raise DockerfileError(f"invalid name for build stage: {name}", instruction.line)
    platform = next((value for key, value in map(_flag, instruction.flags) if key == "--platform"), None)
    return _Stage(name, words[0], platform, instruction.line, [], {})


def _flag(flag: Token) -> tuple[str, Token]:
    key, value = flag.cut("=")
    return key.text, value


def _sources(instruction: Instruction) -> Iterator[Token]:
    """The stages or images that its flags name."""
    for key, value in map(_flag, instruction.flags):
        if instruction.name == "COPY" and key == "--from" and value.text:
            yield value
        elif instruction.name == "RUN" and key == "--mount":
            named = [setting for word, setting in _fields(value) if word == "from"]
            yield from (setting for setting in named[-1:] if setting.text)


def _fields(mount: Token) -> Iterator[tuple[str, Token]]:
    """Splits key=value,key=value."""
    for match in re.finditer("[^,]+", mount.text):
        key, value = mount.part(*match.span()).cut("=")
        yield key.text.lower(), value


def _of_buildkit(instruction: Instruction) -> bool:
    known = CLASSIC_FLAGS.get(instruction.name)
    return instruction.heredocs or (known is not None and any(_flag(f)[0] not in known for f in instruction.flags))


def _quoted_words(text: str, escape: str) -> Sequence[str]:
    """Words with their quotes and escapes; a quoted or escaped space does not end a word."""
    sign = re.escape(escape)
    single, double = "'[^']*'?", rf'"(?:{sign}.|[^"{sign}])*"?'
    return re.findall(rf"""(?:{sign}.|{single}|{double}|[^\s'"{sign}]|{sign}$)+""", text)


def _platform_arguments(prefix: str, platform: str) -> dict[str, str]:
    """BUILDPLATFORM, BUILDOS, ... or TARGETPLATFORM, ... as BuildKit predefines them."""
    parts = platform.split("/")
    system, architecture, variant = ("linux", parts[0], "") if len(parts) == 1 else (*parts, "")[:3]
    architecture = ARCHITECTURES.get(architecture.lower(), architecture)
    variant = "" if (architecture, variant) == ("arm64", "v8") else variant
    variant = "v7" if (architecture, variant) == ("arm", "") else variant
    whole = "/".join(part for part in (system, architecture, variant) if part)
    names = {"PLATFORM": whole, "OS": system, "ARCH": architecture, "VARIANT": variant}
    return {prefix + name: value for name, value in names.items()}
