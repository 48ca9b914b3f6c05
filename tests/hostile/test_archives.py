"""`rorg image load` refuses any file but an archive of images, soon, and without reading all of it into memory."""

from __future__ import annotations

import io
import json
import os
import tarfile
import tracemalloc

import pytest
from fuzzing import Case, fuzz
from measured import measured
from robots import write_tree

from rorg.errors import Invalid
from rorg.images.archive import MOST, RECORDS, read_records, write_archive
from rorg.images.records import Built

ZEROS = bytes(10 << 10)


def member(name: str = RECORDS, content: bytes = b"", **facts) -> bytes:
    """A member of a tar whose header says what it likes."""
    info = tarfile.TarInfo(name)
    info.size = len(content)
    for key, value in facts.items():
        setattr(info, key, value)
    return info.tobuf(tarfile.GNU_FORMAT) + content + bytes(-len(content) % 512)


def image_tar() -> bytes:
    """What `docker save` writes, in short."""
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as tar:
        for name, content in (("manifest.json", b"[]"), ("layer/layer.tar", b"x" * 2000)):
            info = tarfile.TarInfo(name)
            info.size = len(content)
            tar.addfile(info, io.BytesIO(content))
    return file.getvalue()


def saved() -> bytes:
    """What `rorg image save` writes."""
    file = io.BytesIO()
    write_archive([image_tar()], {"a" * 64: Built("eye", "eye:1", bases={"base": "sha256:0"})}, file)
    return file.getvalue()


BAD = {
    "zeros": ZEROS,
    "deep JSON": member(content=b'{"a":' * 100_000 + b"1" + b"}" * 100_000) + ZEROS,
    "a list": member(content=b"[]") + ZEROS,
    "no record": member(content=b'{"a": {"name": "b"}}') + ZEROS,
    "a record of numbers": member(content=b'{"a": {"name": 1, "reference": 2}}') + ZEROS,
    "bases that are a list": member(content=b'{"a": {"name": "b", "reference": "c", "bases": [1]}}') + ZEROS,
    "more digits than Python reads": member(content=b'{"a": ' + b"9" * 5000 + b"}") + ZEROS,
    "a symbolic link": member(type=tarfile.SYMTYPE, linkname="/etc/shadow") + ZEROS,
    "a hard link": member(type=tarfile.LNKTYPE, linkname="nothing") + ZEROS,
    "a sparse member": member(type=tarfile.GNUTYPE_SPARSE) + ZEROS,
    "a member of 3 GiB": member(size=3 << 30) + ZEROS,
    "a member of less than nothing": member(size=-1) + ZEROS,
    "a member that ends too early": member(size=1 << 20) + ZEROS,
}


@pytest.mark.parametrize("content", BAD.values(), ids=BAD)
def test_what_is_no_archive_of_images_is_told(tmp_path, content):
    path = tmp_path / "robot.tar"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with path.open("rb") as file, pytest.raises(Invalid, match="it is not an archive of images"):
            read_records(file, "robot.tar")
        assert tracemalloc.get_traced_memory()[1] < 4 * MOST
    finally:
        tracemalloc.stop()


def test_a_sparse_file_of_3_gib_costs_no_memory(tmp_path):
    path = tmp_path / "robot.tar"
    path.write_bytes(member(size=3 << 30))
    os.truncate(path, (3 << 30) + 2048)
    tracemalloc.start()
    try:
        with path.open("rb") as file, pytest.raises(Invalid, match="not a file of at most"):
            read_records(file, "robot.tar")
        assert tracemalloc.get_traced_memory()[1] < MOST
    finally:
        tracemalloc.stop()


def test_what_was_saved_is_read():
    assert read_records(io.BytesIO(saved()), "x") == {"a" * 64: Built("eye", "eye:1", bases={"base": "sha256:0"})}
    assert read_records(io.BytesIO(image_tar()), "x") == {}


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda path: path.write_bytes(ZEROS), "not an archive of images"),
        (lambda path: path.write_bytes(member("else", b"x") + ZEROS), ""),
        (lambda path: path.write_bytes(member(content=b"{}") + ZEROS), ""),
        (os.mkfifo, "not a regular file"),
        (lambda path: path.symlink_to("/dev/zero"), "not a regular file"),
    ],
    ids=["zeros", "another file", "no images", "a pipe", "a device"],
)
def test_a_load_that_loads_nothing_fails(dockerd, tmp_path, make, said):
    write_tree(tmp_path / "tree", {"camera": {}})
    make(tmp_path / "robot.tar")
    env = {"DOCKER_HOST": dockerd.host, "RORG_STATE_DIR": str(tmp_path / "state"), "RORG_ENGINE": "docker"}
    found = measured("image", "load", "robot.tar", "--manifests", "tree", cwd=tmp_path, env=env)
    assert found.code in (2, 4), found
    assert "cannot" in found.out
    assert "Traceback" not in found.out
    assert said in found.out


@pytest.mark.fuzz
def test_mutated_archives_are_read_or_refused():
    whole = saved()

    def attempt(case: Case) -> None:
        content = bytearray(whole)
        for _ in range(case.chance.randint(1, 6)):
            # Most of what is read is the head of the first member, and its content.
            end = case.chance.choice((512, 1024, 1024, len(content)))
            at = case.chance.randrange(min(end, len(content)))
            some = case.chance.randbytes(case.chance.randint(1, 12))
            piece = case.chance.choice((b"", b"\0", b"\xff", some, b"7777777", b"{", b"[" * 50, b'"'))
            content[at : at + case.chance.choice((0, len(piece), 1, 40))] = piece
        if case.chance.random() < 0.7 and len(content) >= 512:
            content[148:156] = b"%06o\0 " % tarfile.calc_chksums(bytes(content[:512]))[0]
        case.text = bytes(content)
        try:
            found = read_records(io.BytesIO(case.text), "x")
        except Invalid:
            return
        json.dumps({name: built.reference for name, built in found.items()})

    fuzz("archives", 100, attempt)
