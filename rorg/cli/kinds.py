"""Kinds of values on the command line: durations, times, numbers within limits, names, files and directories. Each
reads the text of a value; what is wrong with it becomes typer's error for that option."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from pathlib import Path

import typer
from typer._click.shell_completion import CompletionItem
from typer.models import TyperPath

from rorg.model.event_kinds import EVENT_KINDS
from rorg.model.units import format_seconds, parse_duration, parse_since, stamp

KINDS = {
    "service": ("services", "service", "svc"),
    "group": ("groups", "group"),
    "image": ("images", "image"),
    "network": ("networks", "network"),
    "volume": ("volumes", "volume"),
    "profile": ("profiles", "profile"),
    "machine": ("machines", "machine"),
    "policy": ("policies", "policy"),
    "request": ("requests", "request"),
}
"""Kind of manifest in lower case -> its names in a command line; the first is the folder of its manifests."""
KIND_OF = {name: names[0] for names in KINDS.values() for name in names}
"""Name of a kind in a command line -> the kind, as its folder is named."""
SERVICE = re.compile(rf"({'|'.join(KINDS['service'])})/(?=.)")
"""In front of a name, as users of kubectl write it: service/navigation."""


class Seconds(float):
    """A default duration, which help shows with its unit."""

    def __str__(self) -> str:
        return format_seconds(self)


class CompletedPath(TyperPath):
    """A path that the shell itself completes. Whether it exists and may be read, the command checks."""

    def __init__(self, completes: str, path_type: type = Path) -> None:
        super().__init__(readable=False, path_type=path_type)
        self.completes = completes

    def shell_complete(self, _ctx: object, _param: object, incomplete: str) -> list[CompletionItem]:
        """One item: what the shell may complete."""
        return [CompletionItem(incomplete, type=self.completes)]


FILE, DIRECTORY = CompletedPath("file"), CompletedPath("dir")
FILE_NAME, DIRECTORY_NAME = CompletedPath("file", str), CompletedPath("dir", str)
"""The same for values that may be something else, such as a URL."""


def duration(text: str | float) -> float:
    """Seconds of "10s", "1m30s" or "10"."""
    if isinstance(text, float):
        return text  # a default
    try:
        return parse_duration(f"{text}s" if text.replace(".", "", 1).isdecimal() and text.isascii() else text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


def durations(least: float, most: float = math.inf) -> Callable[[str | float], float]:
    """A reader of durations within limits, in seconds."""
    return _within(duration, least, most)


def numbers(least: float, most: float = math.inf) -> Callable[[str | float], float]:
    """A reader of numbers within limits."""
    return _within(number, least, most)


def number(text: str | float) -> float:
    """A number that is neither infinite nor NaN, which typer's own float lets pass."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise typer.BadParameter(f"'{text}' is not a number")
    return value


def moment(text: str) -> str:
    """ISO 8601 in UTC of a time, or of so long ago: 10m, 2026-01-31T12:00:00Z."""
    try:
        return stamp(parse_since(text, time.time()))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


def service_name(text: str) -> str:
    """The name of a service, without its kind in front."""
    return SERVICE.sub("", text)


def event_kinds(text: str) -> str:
    """Kinds of events in a list with commas."""
    unknown = [word for word in words(text) if word not in EVENT_KINDS]
    if unknown:
        raise typer.BadParameter(f"no event has the kind '{unknown[0]}'; the kinds are {', '.join(EVENT_KINDS)}")
    return text


def words(text: str) -> list[str]:
    """The words of a list with commas."""
    return [word for part in text.split(",") if (word := part.strip())]


def _within(read: Callable[[str | float], float], least: float, most: float) -> Callable[[str | float], float]:
    def convert(text: str | float) -> float:
        value = read(text)
        if value < least:
            raise typer.BadParameter(f"{text} is too small; the minimum is {least:g}")
        if value > most:
            raise typer.BadParameter(f"{text} is too large; the maximum is {most:g}")
        return value

    convert.__name__ = read.__name__  # typer shows it as the kind of value
    return convert
