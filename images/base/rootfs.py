"""Writes a root file system, as a tar stream, made of this machine's own Python: the least that stand-ins run on.

Usage: python3 rootfs.py | docker import - rorg-base

It holds the interpreter and its standard library, /bin/sh, /usr/bin/env, the libraries that these load, and a few
files of /etc. All of it keeps its path, so the interpreter finds its library and the loader finds the rest.
"""

from __future__ import annotations

import importlib.util
import io
import marshal
import os
import re
import socket  # noqa: F401 - to be among the compiled modules
import subprocess
import sys
import sysconfig
import tarfile
from collections.abc import Iterable, Iterator
from pathlib import Path

SKIPPED = re.compile(
    r"(tests?|idlelib|idle_test|tkinter|turtledemo|ensurepip|lib2to3|distutils|pydoc_data|site-packages|dist-packages"
    r"|__pycache__|config-.*|_tkinter\..*)$"
)
"""Files and folders of the standard library that no stand-in imports."""
ACCOUNTS = {
    "etc/passwd": "root:x:0:0:root:/root:/bin/sh\n",
    "etc/group": "root:x:0:\ndialout:x:20:\naudio:x:29:\nvideo:x:44:\nplugdev:x:46:\ninput:x:104:\n",
}
FOLDERS = {"tmp": 0o1777, "root": 0o755, "dev": 0o755, "proc": 0o555, "sys": 0o555, "run": 0o755, "var": 0o755}


class Root:
    """The tar stream, and which paths it already has."""

    def __init__(self, stream: io.RawIOBase) -> None:
        self.tar = tarfile.open(fileobj=stream, mode="w|")  # noqa: SIM115
        self.have: set[str] = {"."}

    def _entry(self, name: str, kind: bytes, mode: int, link: str = "", data: bytes = b"") -> None:
        """One entry, with its folders before it. Owner and time are fixed: the same machine gives the same stream."""
        if name in self.have:
            return
        parent = os.path.dirname(name)
        if parent:
            self._entry(parent, tarfile.DIRTYPE, 0o755)
        info = tarfile.TarInfo(name)
        info.type, info.mode, info.linkname, info.size = kind, mode, link, len(data)
        self.tar.addfile(info, io.BytesIO(data))
        self.have.add(name)

    def folder(self, name: str, mode: int) -> None:
        self._entry(name, tarfile.DIRTYPE, mode)

    def data(self, name: str, data: bytes) -> None:
        self._entry(name, tarfile.REGTYPE, 0o644, data=data)

    def link(self, name: str, target: str) -> None:
        self._entry(name, tarfile.SYMTYPE, 0o777, link=target)

    def copy(self, path: str) -> None:
        """A file of this machine at its own path: its folders by their real names, and the chain of links to it."""
        place = os.path.join(os.path.realpath(os.path.dirname(path)), os.path.basename(path))
        if os.path.islink(place):
            target = os.readlink(place)
            self.link(place[1:], target)
            self.copy(os.path.join(os.path.dirname(place), target))
        else:
            self._entry(place[1:], tarfile.REGTYPE, os.stat(place).st_mode & 0o755, data=Path(place).read_bytes())


def libraries(programs: Iterable[str]) -> set[str]:
    """What the loader would load for these programs and modules, the loader itself included."""
    found = subprocess.run(["ldd", *programs], capture_output=True, text=True, check=False).stdout
    return set(re.findall(r"(?:=> |^\t)(/\S+) \(0x", found, re.M))


def standard_library(folder: str) -> Iterator[str]:
    for base, folders, files in os.walk(folder):
        folders[:] = sorted(f for f in folders if not SKIPPED.match(f))
        yield from (os.path.join(base, f) for f in sorted(files) if not SKIPPED.match(f))


def compiled(library: list[str]) -> Iterator[tuple[str, bytes]]:
    """Bytecode (PEP 552, unchecked) of what this program has loaded: a start that compiles it takes 50 ms more."""
    loaded = {getattr(module, "__file__", None) for module in list(sys.modules.values())}
    for path in [p for p in library if p in loaded and p.endswith(".py")]:
        source = Path(path).read_bytes()
        head = importlib.util.MAGIC_NUMBER + (1).to_bytes(4, "little") + importlib.util.source_hash(source)
        yield importlib.util.cache_from_source(path), head + marshal.dumps(compile(source, path, "exec", 0, True))


def write(root: Root) -> None:
    for name in ("bin", "sbin", "lib", "lib64", "lib32"):
        if os.path.islink(f"/{name}"):
            target = os.readlink(f"/{name}")
            root.folder(os.path.join("/", target)[1:], 0o755)
            root.link(name, target)
    python = os.path.realpath(sys.executable)
    library = sorted(standard_library(sysconfig.get_path("stdlib")))
    programs = [python, os.path.realpath("/bin/sh"), os.path.realpath("/usr/bin/env")]
    modules = [path for path in library if path.endswith(".so")]
    for path in ["/bin/sh", "/usr/bin/env", python, *library, *sorted(libraries(programs + modules))]:
        root.copy(path)
    for path, data in compiled(library):
        root.data(path[1:], data)
    for name in ("usr/bin/python3", "usr/local/bin/python3"):
        root.link(name, python)
    for name, mode in FOLDERS.items():
        root.folder(name, mode)
    for name, text in ACCOUNTS.items():
        root.data(name, text.encode())
    root.tar.close()


if __name__ == "__main__":
    write(Root(sys.stdout.buffer))  # type: ignore[arg-type]
