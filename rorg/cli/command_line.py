"""Reads a command line by the declarations of its command (options.py).

It takes what GNU programs take: options anywhere, --name=value, -ovalue, flags together as in -it, and -- before words
that are not options. It is not argparse or typer: to import those takes longer than most commands.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rorg.cli.options import KINDS, SERVICES, Argument, Option
from rorg.cli.signature import Parameter, parted
from rorg.cli.usage import misread, unknown_option

SERVICE = re.compile(rf"({'|'.join(KINDS['service'])})/(?=.)")
"""In front of a name, as users of kubectl write it: service/navigation."""
WORDS = {int: "a whole number", float: "a number"}


def read(
    name: str, declared: Sequence[Parameter], words: Sequence[str], environment: Mapping[str, str]
) -> dict[str, Any]:
    """The values of a command's parameters, by their names. Raises Invalid."""
    words, after = parted(declared, words)
    texts, rest = _split(name, declared, words)
    values = {**_arguments(name, declared, rest), **after}
    if missing := [taker for taker, taken in after.items() if not taken]:
        raise misread(name, f"{missing[0].upper()} is missing after --")
    for parameter in declared:
        if isinstance(parameter.declared, Option):
            values[parameter.name] = _option(name, parameter, texts.get(parameter.name, []), environment)
    return values


def _split(name: str, declared: Sequence[Parameter], words: Sequence[str]) -> tuple[dict[str, list[str]], list[str]]:
    """(the texts of each option, one for each time that it is given; the words that are not options)."""
    options = {n: p for p in declared if isinstance(p.declared, Option) for n in p.declared.names}
    texts: dict[str, list[str]] = {}
    rest: list[str] = []
    left = list(words)
    while left:
        word = left.pop(0)
        if word == "--":
            return texts, rest + left
        if word == "-" or not word.startswith("-"):
            rest.append(word)
            continue
        option, equals, text = word.partition("=") if word.startswith("--") else (word[:2], "", word[2:])
        parameter = options.get(option)
        if parameter is None:
            raise unknown_option(name, option, declared)
        if parameter.flag and equals:
            raise misread(name, f"{option} takes no value")
        if parameter.flag:
            left[:0] = ["-" + text] if text else []  # flags together
            text = ""
        elif isinstance(parameter.declared, Option) and parameter.declared.bare and not equals:
            text = parameter.declared.bare
        elif not (equals or text):
            if not left:
                raise misread(name, f"{option} needs a value")
            text = left.pop(0)
        texts.setdefault(parameter.name, []).append(text)
    return texts, rest


def _arguments(name: str, declared: Sequence[Parameter], words: list[str]) -> dict[str, Any]:
    arguments: dict[str, Any] = {}
    for parameter in declared:
        if not isinstance(parameter.declared, Argument) or parameter.rest:
            continue
        taken, words = (words, []) if parameter.many else (words[:1], words[1:])
        if parameter.required and not taken:
            raise misread(name, f"{parameter.name.upper()} is missing")
        values = [_value(name, parameter, parameter.name.upper(), text) for text in taken]
        arguments[parameter.name] = (values if parameter.many else values[0]) if taken else parameter.default
    if words:
        raise misread(name, f"'{words[0]}' is one word too many")
    return arguments


def _option(name: str, parameter: Parameter, texts: list[str], environment: Mapping[str, str]) -> Any:
    option = parameter.declared
    assert isinstance(option, Option)
    if not texts and option.envvar:
        texts = [text for text in [environment.get(option.envvar, "")] if text]
    if not texts:
        return parameter.default
    if parameter.flag:
        return True
    texts = texts if parameter.many else texts[-1:]
    values = [_value(name, parameter, option.names[-1], text) for text in texts]
    return values if parameter.many else values[-1]


def _value(name: str, parameter: Parameter, called: str, text: str) -> Any:
    """The value of a text. Raises Invalid."""
    declared = parameter.declared
    if declared.choices and text not in declared.choices:
        raise misread(name, f"{called} cannot be '{text}'", f"one of {', '.join(declared.choices)}")
    try:
        return declared.read(text) if isinstance(declared, Option) and declared.parser else _plain(parameter, text)
    except ValueError as error:
        raise misread(name, f"{called}: {error}") from error


def _plain(parameter: Parameter, text: str) -> Any:
    """A text, a path or a number. Raises ValueError."""
    if parameter.type in (str, Path):
        declared = parameter.declared
        named = isinstance(declared, Argument) and declared.completes == SERVICES and not declared.kinds
        return parameter.type(SERVICE.sub("", text) if named else text)
    try:
        value = parameter.type(text)
    except ValueError:
        value = math.nan
    if not -math.inf < value < math.inf:
        raise ValueError(f"'{text}' is not {WORDS[parameter.type]}")
    return parameter.declared.within(value, text) if isinstance(parameter.declared, Option) else value
