"""Programs of the machine that tests run, such as openssl: a test without its program is skipped, or fails in CI.

It is also what happens to tests without a Docker engine or a browser.
"""

from __future__ import annotations

import os
import shutil
from typing import NoReturn

import pytest

PACKAGES = {
    "chattr": "e2fsprogs",
    "dpkg-deb": "dpkg",
    "gpg": "gnupg",
    "gpgconf": "gnupg",
    "protoc": "protobuf-compiler",
    "setpriv": "util-linux",
    "ssh-keygen": "openssh-client",
    "systemd-analyze": "systemd",
}
"""Debian's package of a program, if it has another name."""


def is_required() -> bool:
    """Whether a missing program is a failure: .ci/run installs all of them."""
    return bool(os.environ.get("RORG_TEST_REQUIRE_DOCKER")) or os.environ.get("CI") == "true"


def no_tool(reason: str) -> NoReturn:
    """Skip a test that cannot run here, or fail it if what it lacks is required."""
    if is_required():
        pytest.fail(f"required here: {reason}")
    pytest.skip(reason)


def graphviz() -> None:
    """Skip a test that draws a graph, or fail it, if Graphviz does not work. pygraphviz contains Graphviz, but not all
    libraries that it needs."""
    try:
        import pygraphviz

        pygraphviz.AGraph("digraph { a -> b }").layout("dot")
    except (ImportError, OSError, ValueError) as error:
        no_tool(f"Graphviz does not work here: {error}; try `apt install graphviz`, which has its libraries")


def tool(name: str) -> str:
    """Return the path of a program, as the first word of a command. Without it the test is skipped, or fails."""
    found = shutil.which(name)
    if found is None:
        no_tool(f"no {name} here; try `apt install {PACKAGES.get(name, name)}`")
    return found
