"""Facts about a service from text alone: launch files and scripts that it mounts from the tree."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, TypeVar

from rorg.manifest.files import read_text
from rorg.manifest.validation.subject import Subject
from rorg.model.catalog import Image

MOST = 128 << 10
"""Maximum number of bytes read from one file."""
MOST_FILES = 12
"""Maximum number of files of one service."""
# The texts may come from anyone: each expression below takes linear time.
_NODE = re.compile(r"<node\b([^<>]*)")
_NODE_NAME = re.compile(r"""\bname\s*=\s*["']([A-Za-z][\w/]*)["']""")
_NAMED = re.compile(r"^__name:=(\S+)$")
_ANSWERS = re.compile(r"(?:http://)?(?:localhost|127\.0\.0\.1|\[::1\]):([0-9]{1,5})(?![0-9])")
_CALLED = re.compile(r"(?<![\w.-])(localhost|127\.0\.0\.1|[A-Za-z][\w.-]*):([0-9]{2,5})(?![0-9])")
_WORD = re.compile(r"[\w/.:~-]{3,}")
_NAME = re.compile(r"(?<![\w/.:])/?([A-Za-z]\w{3,})/|(?<![\w/.:~-])/([A-Za-z]\w{3,})(?![\w/.-])")
_END = re.compile(r"""["'`();|&<>]""")
"""Ends a word for a shell. shlex leaves some of these in words, such as the `)` of `$(cat /conf/speed)`."""
_ENDS = re.compile(rf"(?:\s|{_END.pattern})+")
_EXPANDED = re.compile(r"[*?\[\]{}$]")
"""Makes a word a pattern or a value that only the shell knows, and no name of a file."""
LOCAL = ("localhost", "127.0.0.1")
T = TypeVar("T")
READ = (".launch", ".xml", ".sh", ".bash", ".py", ".yaml", ".yml")


def once(find: Callable[[Subject], T]) -> Callable[[Subject], T]:
    """Caches a result with its service, for the next check that asks."""

    @wraps(find)
    def found(subject: Subject) -> T:
        memo: dict[str, Any] = subject.memo
        if find.__name__ not in memo:
            memo[find.__name__] = find(subject)
        value: T = memo[find.__name__]
        return value

    return found


@lru_cache(maxsize=2048)
def _read(path: str, root: str, _stamp: tuple[int, int]) -> str:
    try:
        return read_text(Path(path), Path(root), MOST)
    except OSError:
        return ""


def read(path: str, root: Path) -> str:
    """The text of a small file of the tree; empty if it cannot be read."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return ""
    return _read(path, str(root), (status.st_mtime_ns, status.st_size))


def text_of_dockerfile(image: Image) -> str:
    """The text of an Image's Dockerfile; empty if it has none that can be read."""
    return image.inline or (read(f"{image.context}/{image.dockerfile}", Path(image.context)) if image.context else "")


def inside(subject: Subject, word: str) -> str:
    """The path on the machine of a path in the container, by the mounts from the tree; empty if there is none."""
    for mount in subject.mounts_of_tree:
        if word == mount.target:
            return mount.path
        if word.startswith(f"{mount.target}/"):
            return os.path.normpath(f"{mount.path}/{word.removeprefix(mount.target)}")
    return ""


def _names(subject: Subject, word: str) -> Iterator[str]:
    """The words of a command's word that may each be the name of a file."""
    whole = inside(subject, word)  # a quoted name may have any characters
    for part in _ENDS.split(word) if subject.script and _END.search(word) and not os.path.lexists(whole) else [word]:
        if not _EXPANDED.search(part) or os.path.lexists(whole):
            yield part.partition(":=")[2] or part


@once
def named_files(subject: Subject) -> tuple[tuple[str, str], ...]:
    """(word, path on the machine) of each file of the tree that the command names by its path in the container."""
    words_by_path: dict[str, str] = {}
    commands = subject.commands if subject.mounts_of_tree else ()
    words = (word for command in commands for word in command if "/" in word)
    for name in (name for word in words for name in _names(subject, word)):
        path = inside(subject, name)
        if path and len(words_by_path) < MOST_FILES:
            words_by_path.setdefault(path, name)
    return tuple((word, path) for path, word in words_by_path.items())


@once
def files_of(subject: Subject) -> dict[str, str]:
    """The texts of the tree that a service is started with, by path."""
    texts = {path: read(path, subject.source.root) for _, path in named_files(subject) if path.endswith(READ)}
    return {path: _said(text) if path.endswith((".launch", ".xml")) else text for path, text in texts.items()}


@lru_cache(maxsize=2048)
def _said(text: str) -> str:
    """Removes comments."""
    pieces, at = list[str](), 0
    while (begin := text.find("<!--", at)) >= 0 and (end := text.find("-->", begin + 4)) >= 0:
        pieces.append(text[at:begin])
        at = end + 3
    return " ".join([*pieces, text[at:]])


@once
def texts_of(subject: Subject) -> tuple[str, ...]:
    """All text that a service is started with: its own, then that of each file."""
    values = (f"{name}={value}" for name, value in subject.env.items())
    return ("\n".join((" ".join(subject.words), *values)), *files_of(subject).values())


def text_of(subject: Subject) -> str:
    """The same in one string."""
    return "\n".join(texts_of(subject))


@once
def names_of_nodes(subject: Subject) -> frozenset[str]:
    """Its nodes in the ROS graph, as far as its command, launch files and probes name them."""
    names = {_NAMED.sub(r"\1", word) for command in subject.commands for word in command if word.startswith("__name")}
    names |= {str(asked.probe.target) for asked in subject.asked if asked.probe.kind == "ros_node"}
    own = frozenset(name.strip("/") for name in names)
    return own.union(*map(_nodes_in, files_of(subject).values())) - {"rosout", ""}


@lru_cache(maxsize=2048)
def _nodes_in(text: str) -> frozenset[str]:
    matches = (_NODE_NAME.search(tag) for tag in _NODE.findall(text))
    return frozenset(name[1].strip("/") for name in matches if name)


@lru_cache(maxsize=2048)
def _paths_in(text: str) -> tuple[str, ...]:
    """Words that may be paths, ROS names or network addresses. The slower searches below run only on these."""
    return tuple(word for word in set(_WORD.findall(text)) if "/" in word or ":" in word)


@lru_cache(maxsize=2048)
def names_in(text: str) -> frozenset[str]:
    """Names in the ROS graph: `/scan`, or `scan` in `scan/points`."""
    return frozenset(name for word in _paths_in(text) for pair in _NAME.findall(word) for name in pair if name)


@lru_cache(maxsize=2048)
def _calls_in(text: str) -> frozenset[tuple[str, str]]:
    return frozenset(call for word in _paths_in(text) if ":" in word for call in _CALLED.findall(word))


@once
def ports_of(subject: Subject) -> frozenset[str]:
    """Ports of this machine where it answers, as far as its probes and its published ports name them."""
    probed = (_ANSWERS.match(str(a.probe.target)) for a in subject.asked_ready if a.probe.kind in ("tcp", "http"))
    published = (text.rpartition(":")[0].rpartition(":")[2] for text in subject.options.get("ports") or ())
    return frozenset([*(match[1] for match in probed if match), *filter(None, published)])


@once
def calls_of(subject: Subject) -> frozenset[tuple[str, str]]:
    """(host, port) of each address in its command line, environment, files and probes."""
    probed = (str(a.probe.target) for a in subject.asked if a.probe.kind in ("tcp", "http"))
    return frozenset[tuple[str, str]]().union(*map(_calls_in, (*texts_of(subject), *probed)))


def ports_named(subject: Subject) -> set[str]:
    """Ports of this machine in what it is started with, except its own probes."""
    return {port for text in texts_of(subject) for host, port in _calls_in(text) if host in LOCAL}
