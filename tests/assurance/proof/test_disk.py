"""What a loss of power may leave, and what it may not, of files that are written in known ways."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from proof.disk import MOST_OUTCOMES, Disk


class Folder:
    """A directory whose changes a disk is told of."""

    def __init__(self, path: Path) -> None:
        self.path, self.disk = path, Disk()

    def name(self, name: str) -> str:
        return str(self.path / name)

    def write(self, name: str, text: str, sync: bool) -> None:
        path = self.name(name)
        self.disk.keep(path)
        new = not os.path.exists(path)
        Path(path).write_text(text)
        if new:
            self.disk.created(path)
        self.disk.wrote(path)
        if sync:
            self.disk.synced(path)

    def rename(self, old: str, new: str) -> None:
        self.disk.keep(self.name(old), self.name(new))
        os.rename(self.name(old), self.name(new))
        self.disk.renamed(self.name(old), self.name(new))

    def remove(self, name: str) -> None:
        self.disk.keep(self.name(name))
        os.unlink(self.name(name))
        self.disk.removed(self.name(name))

    def outcomes(self, name: str) -> set[bytes | int | None]:
        """What may be there of a file, that of no loss included."""
        kept = [*self.disk.outcomes(1), tuple(range(len(self.disk.log)))]
        states = [self.disk.state(k) for k in kept]
        there = Path(self.name(name)).read_bytes() if Path(self.name(name)).exists() else None
        return {s.get(self.name(name), there) for s in states}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "file").write_text("old")
    return Folder(tmp_path)


def replace(folder: Folder, contents: bool, names: bool) -> None:
    folder.write("new", "new", sync=contents)
    folder.rename("new", "file")
    if names:
        folder.disk.synced(str(folder.path))


def test_a_rename_without_fsync_may_come_before_the_contents(folder):
    replace(folder, contents=False, names=False)
    assert folder.outcomes("file") == {b"old", b"", b"new"}


def test_with_fsync_of_the_contents_it_is_the_old_file_or_the_new_one(folder):
    replace(folder, contents=True, names=False)
    assert folder.outcomes("file") == {b"old", b"new"}
    assert None in folder.outcomes("new")


def test_with_fsync_of_the_names_too_nothing_can_be_lost(folder):
    replace(folder, contents=True, names=True)
    assert folder.disk.outcomes(1) == []
    assert folder.disk.log == []


def test_a_file_that_is_written_in_place_may_be_the_old_one(folder):
    folder.write("file", "n", sync=False)
    assert folder.outcomes("file") == {b"old", b"n"}


def test_of_two_changes_the_later_one_may_be_there_alone(folder):
    (folder.path / "note").write_text("note")
    folder.write("new", "new", sync=True)
    folder.rename("new", "file")
    folder.remove("note")
    path, note = folder.name("file"), folder.name("note")
    found = {(s[path], s[note]) for s in map(folder.disk.state, folder.disk.outcomes(1))}
    assert (b"old", None) in found
    assert (b"new", b"note") in found


def test_what_is_left_is_written_to_the_files(folder):
    replace(folder, contents=True, names=False)
    everything = tuple(range(len(folder.disk.log)))
    folder.disk.leave(everything[:1])
    assert Path(folder.name("file")).read_text() == "old"
    folder.disk.leave(everything)
    assert Path(folder.name("file")).read_text() == "new"
    folder.disk.leave(())
    assert not Path(folder.name("new")).exists()


def test_a_directory_that_gets_its_name_may_have_the_old_one(folder):
    part, place = folder.path / "part", folder.path / "place"
    folder.disk.keep(str(part))
    part.mkdir()
    folder.disk.made(str(part))
    folder.write("part/a", "a", sync=True)
    folder.rename("part", "place")
    assert (place / "a").read_text() == "a"
    last = len(folder.disk.log) - 1
    folder.disk.leave(tuple(range(last)))
    assert (part / "a").read_text() == "a"
    assert not place.exists()


def test_outcomes_are_bounded(folder):
    for number in range(30):
        folder.write(f"f{number}", "x", sync=False)
    assert len(folder.disk.outcomes(1)) == MOST_OUTCOMES
