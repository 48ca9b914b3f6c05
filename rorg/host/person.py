"""The person who runs a command."""

from __future__ import annotations

import os
import pwd
from collections.abc import Mapping
from typing import NamedTuple


class Person(NamedTuple):
    """A user of this machine, who need not be in any of its files."""

    uid: int
    gid: int
    name: str
    home: str
    """The directory; empty if it is not known."""

    @property
    def numbers(self) -> str:
        """The form in which an engine takes a user that an image does not know."""
        return f"{self.uid}:{self.gid}"


def caller(environment: Mapping[str, str], uid: int, gid: int) -> Person:
    """The user `uid` and `gid`; behind sudo, the user who called it (it sets SUDO_UID and SUDO_GID)."""
    behind, home = (environment.get("SUDO_UID", ""), environment.get("SUDO_GID", "")), environment.get("HOME", "")
    if uid == 0 and all(number.isascii() and number.isdigit() for number in behind):
        (uid, gid), home = map(int, behind), ""
    try:
        entry = pwd.getpwuid(uid)
    except (KeyError, OverflowError):
        return Person(uid, gid, str(uid), home)
    return Person(uid, gid, entry.pw_name, home or entry.pw_dir)


def called(login: str) -> Person:
    """The user with this login; if this machine does not know it, only its name counts. HOME is that of the user who
    runs rorg, as git takes it."""
    try:
        entry = pwd.getpwnam(login)
    except (KeyError, ValueError):
        return Person(-1, -1, login, "")
    home = os.path.expanduser("~") if entry.pw_uid == os.geteuid() else entry.pw_dir
    return Person(entry.pw_uid, entry.pw_gid, login, home)
