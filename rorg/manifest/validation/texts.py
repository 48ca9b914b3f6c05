"""What is known of a service by text alone: launch files and scripts that it mounts from the tree."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from rorg.manifest.files import read_text
from rorg.manifest.validation.subject import Subject

MOST = 128 << 10
"""Bytes of one file that are read."""
MOST_FILES = 12
"""Files of one service."""
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_NODE = re.compile(r"""<node\b[^>]*?\bname\s*=\s*["']([A-Za-z][\w/]*)["']""", re.DOTALL)
_NAMED = re.compile(r"^__name:=(\S+)$")
_ANSWERS = re.compile(r"(?:http://)?(?:localhost|127\.0\.0\.1|\[::1\]):([0-9]{1,5})(?![0-9])")
_CALLED = re.compile(r"(?<![\w.-])(localhost|127\.0\.0\.1|[A-Za-z][\w.-]*):([0-9]{2,5})(?![0-9])")
LOCAL = ("localhost", "127.0.0.1")
READ = (".launch", ".xml", ".sh", ".bash", ".py", ".yaml", ".yml")


@lru_cache(maxsize=4096)
def _read(path: str, root: str, _stamp: tuple[int, int]) -> str:
    try:
        return read_text(Path(path), Path(root), MOST)
    except OSError:
        return ""


def read(path: str, root: Path) -> str:
    """The text of a small file of the tree; empty for what is none."""
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return ""
    return _read(path, str(root), (found.st_mtime_ns, found.st_size))


def inside(subject: Subject, word: str) -> str:
    """Where on the machine a path of the container is, by what is mounted from the tree; empty where it is not."""
    for mount in subject.mounts_of_tree:
        if word == mount.target:
            return mount.path
        if word.startswith(f"{mount.target}/"):
            return os.path.normpath(f"{mount.path}/{word.removeprefix(mount.target)}")
    return ""


def named_files(subject: Subject) -> list[tuple[str, str]]:
    """(word, path on the machine) of each file of the tree that the command names by its path in the container."""
    if "named" not in subject.memo:
        subject.memo["named"] = list(_named_files(subject)) if subject.mounts_of_tree else []
    return list(subject.memo["named"])


def _named_files(subject: Subject) -> Iterator[tuple[str, str]]:
    seen: set[str] = set()
    for command in subject.commands:
        for word in command:
            path = inside(subject, word.partition(":=")[2] or word) if "/" in word else ""
            if path and path not in seen and len(seen) < MOST_FILES:
                seen.add(path)
                yield word, path


def files_of(subject: Subject) -> dict[str, str]:
    """The texts of the tree that a service is started with, by their paths."""
    if "files" not in subject.memo:
        subject.memo["files"] = _files_of(subject)
    return dict(subject.memo["files"])


def _files_of(subject: Subject) -> dict[str, str]:
    found = {path: read(path, subject.source.root) for _, path in named_files(subject) if path.endswith(READ)}
    return {
        path: _COMMENT.sub(" ", text) if path.endswith((".launch", ".xml")) else text for path, text in found.items()
    }


def text_of(subject: Subject) -> str:
    """All words that a service is started with."""
    if "text" not in subject.memo:
        values = (f"{name}={value}" for name, value in subject.env.items())
        subject.memo["text"] = "\n".join((" ".join(subject.words), *values, *files_of(subject).values()))
    return str(subject.memo["text"])


def names_of_nodes(subject: Subject) -> set[str]:
    """Its nodes in the ROS graph, as far as its command, its launch files and its probes name them."""
    if "nodes" not in subject.memo:
        subject.memo["nodes"] = _names_of_nodes(subject)
    return set(subject.memo["nodes"])


def _names_of_nodes(subject: Subject) -> set[str]:
    found = {_NAMED.sub(r"\1", word) for command in subject.commands for word in command if _NAMED.match(word)}
    for text in files_of(subject).values():
        found |= set(_NODE.findall(text))
    found |= {str(asked.probe.target) for asked in subject.asked if asked.probe.kind == "ros_node"}
    return {name.strip("/") for name in found} - {"rosout", ""}


def ports_of(subject: Subject) -> frozenset[str]:
    """Ports of this machine at which it answers, as far as its probes and what it publishes name them."""
    if "ports" not in subject.memo:
        subject.memo["ports"] = frozenset(_ports_of(subject))
    found: frozenset[str] = subject.memo["ports"]
    return found


def _ports_of(subject: Subject) -> Iterator[str]:
    for asked in subject.asked_ready:
        if asked.probe.kind in ("tcp", "http"):
            found = _ANSWERS.match(str(asked.probe.target))
            yield from found.groups() if found else ()
    for text in subject.options.get("ports") or ():
        if isinstance(text, str) and text.count(":") >= 1:
            yield text.rpartition(":")[0].rpartition(":")[2]


def calls_of(subject: Subject) -> frozenset[tuple[str, str]]:
    """(host, port) of each place that its words, its environment, its files and its probes name."""
    if "calls" not in subject.memo:
        probed = (str(a.probe.target) for a in subject.asked if a.probe.kind in ("tcp", "http"))
        subject.memo["calls"] = frozenset(_CALLED.findall("\n".join((text_of(subject), *probed))))
    found: frozenset[tuple[str, str]] = subject.memo["calls"]
    return found
