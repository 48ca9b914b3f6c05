"""Selects wheels for a machine that may differ from this one: with Debian's name of its architecture, and a version of
CPython. `make deb`, `make arm` and `.ci/versions` use it."""

from __future__ import annotations

MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
"""Debian's name of an architecture -> the name in file names of wheels."""
GLIBC = 28
"""Minor version of glibc 2 that the wheels may need: Debian 10, Ubuntu 18.10 and all later ones have it."""


def selection(architecture: str, minor: int) -> list[str]:
    """Options for `pip install --target` and `pip download`. pip takes a wheel only for the platforms that it is given,
    not for older ones that these include."""
    names = ["manylinux2014", *(f"manylinux_2_{glibc}" for glibc in range(17, GLIBC + 1))]
    platforms = [f"--platform={name}_{MACHINES[architecture]}" for name in names]
    return ["--only-binary=:all:", "--implementation=cp", f"--python-version=3.{minor}", *platforms]
