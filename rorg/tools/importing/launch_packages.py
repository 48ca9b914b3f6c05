"""The ROS packages around a launch file: where their files are on this machine, and what the robot calls them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from rorg.tools.importing.launch_version import ros_of_package

Read = Callable[[Path], str]
"""The text of a file. Raises OSError."""
_SHARE = re.compile(r"\$\(find-pkg-share ([\w-]+)\)(/.*)?")


@dataclass(frozen=True)
class Package:
    """The package that a launch file is in; all empty if it is in none."""

    folder: Path | None = None
    name: str = ""
    ros: int = 0


def package_of(path: Path, read: Read) -> Package:
    """The package of a file: that of the nearest package.xml that can be read."""
    for folder in path.parents:
        try:
            text = read(folder / "package.xml")
        except OSError:
            continue
        match = re.search(r"<name>\s*([\w-]+)\s*</name>", text)
        return Package(folder, match[1] if match else "", ros_of_package(text))
    return Package()


@dataclass
class Packages:
    """The package of the imported file, and those in folders beside it."""

    own: Package
    read: Read
    _folders: dict[str, Path | None] = field(default_factory=dict)

    def shown(self, path: Path) -> str:
        """A path as the robot finds it: below the share folder of its package if it is in one."""
        folders = {self.own.name: self.own.folder, **self._folders}
        for name, folder in folders.items():
            if name and folder and path.is_relative_to(folder):
                below = path.relative_to(folder).as_posix()
                return f"$(find-pkg-share {name})" + (f"/{below}" if below != "." else "")
        return str(path)

    def here(self, path: str) -> Path | None:
        """The path of a file on this machine; None if its package is not known here."""
        match = _SHARE.fullmatch(path)
        if not match:
            return None if "$(" in path else Path(path)
        folder = self._folder(match[1])
        return Path(f"{folder}{match[2] or ''}") if folder else None

    def _folder(self, name: str) -> Path | None:
        if name == self.own.name:
            return self.own.folder
        if name not in self._folders:
            beside = self.own.folder.parent / name if self.own.folder else None
            found = package_of(beside / "package.xml", self.read) if beside else Package()
            self._folders[name] = beside if beside and found.name == name and found.folder == beside else None
        return self._folders[name]
