"""Reads a simple command line by the command's own declaration, without typer, whose import costs more than most
commands take. What is not plain and certain is left to typer, which also says every error and all help."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rorg.cli.options import Argument, Option
from rorg.cli.signature import Parameter, parted

NUMBERS: dict[Any, str] = {int: r"[0-9]{1,9}", float: r"[0-9]{1,9}(\.[0-9]{1,9})?"}


class _NotPlain(Exception):
    """Typer shall read it."""


def read(declared: Sequence[Parameter], words: Sequence[str], environment: Mapping[str, str]) -> dict[str, Any] | None:
    """The values of a command's parameters, by name; None for a line that is left to typer."""
    try:
        words, after = parted(declared, words)
        texts, rest = _split(declared, words)
        found = {**_arguments(declared, rest), **after}
        if not all(after.values()):
            raise _NotPlain
        for parameter in declared:
            if isinstance(parameter.declared, Option):
                found[parameter.name] = _option(parameter, parameter.declared, texts, environment)
    except _NotPlain:
        return None
    return found


def _split(declared: Sequence[Parameter], words: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """(texts of the options that are named, which a flag has none of; words that are no options)."""
    options = {n: p for p in declared if isinstance(p.declared, Option) for n in p.declared.names}
    texts: dict[str, str] = {}
    rest: list[str] = []
    left = iter(words)
    for word in left:
        if word == "--":
            rest += left
            break
        if not word.startswith("-"):
            rest.append(word)
            continue
        name, equals, value = word.partition("=") if word.startswith("--") else (word, "", "")
        found = options.get(name)
        if found is None or found.name in texts or found.many or (equals and found.flag):
            raise _NotPlain
        if not found.flag and not equals:
            value = next(left, "")
        if not found.flag and (not value or value.startswith("-")):
            raise _NotPlain
        texts[found.name] = value
    return texts, rest


def _arguments(declared: Sequence[Parameter], words: list[str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for parameter in declared:
        if not isinstance(parameter.declared, Argument) or parameter.rest:
            continue
        taken, words = (words, []) if parameter.many else (words[:1], words[1:])
        if not all(taken) or (parameter.required and not taken):
            raise _NotPlain
        values = [_value(parameter, text) for text in taken]
        found[parameter.name] = (values if parameter.many else values[0]) if taken else parameter.default
    if words:
        raise _NotPlain
    return found


def _option(parameter: Parameter, option: Option, texts: Mapping[str, str], environment: Mapping[str, str]) -> Any:
    if parameter.flag:
        return True if parameter.name in texts else parameter.default
    text = texts.get(parameter.name) or (environment.get(option.envvar, "") if option.envvar else "")
    return _value(parameter, text) if text else parameter.default


def _value(parameter: Parameter, text: str) -> Any:
    declared = parameter.declared
    if isinstance(declared, Option) and declared.parser:
        try:
            return declared.read(text)
        except ValueError:
            raise _NotPlain from None
    if parameter.type in NUMBERS:
        return _number(parameter, text)
    if parameter.type in (str, Path):
        return parameter.type(text)
    raise _NotPlain


def _number(parameter: Parameter, text: str) -> float:
    option = parameter.declared
    if not isinstance(option, Option) or not re.fullmatch(NUMBERS[parameter.type], text):
        raise _NotPlain
    found: float = parameter.type(text)
    if (option.least is not None and found < option.least) or (option.most is not None and found > option.most):
        raise _NotPlain
    return found
