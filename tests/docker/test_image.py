"""`rorg image`: what was built, what of it may go, and all of it in a file for another machine."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import pytest
from commands import rorg
from common import BASE_IMAGE
from robots import write_tree

from rorg.errors import Invalid
from rorg.images.archive import RECORDS, read_records
from rorg.images.disk_usage import own_images
from rorg.images.order import LABEL_BUILDER, LABEL_IMAGE
from rorg.images.records import Built, Records
from rorg.model.image_names import plain


class Lab:
    """A robot whose camera is made of an image of its tree, called by a name that nobody else has."""

    def __init__(self, folder: Path, host: str, name: str) -> None:
        self.folder, self.name = folder, name
        self.where = {"RORG_STATE_DIR": str(folder / "state"), "DOCKER_HOST": host, "RORG_ENGINE": "docker"}
        write_tree(folder / "tree", {"camera": {"image": name}})
        (folder / "tree/images").mkdir()
        spec = {"context": "../../eye"}
        manifest = {"apiVersion": "rorg/v1", "kind": "Image", "metadata": {"name": name}, "spec": spec}
        (folder / f"tree/images/{name}.yaml").write_text(json.dumps(manifest))
        (folder / "eye").mkdir()
        self.write("1")

    def write(self, version: str) -> None:
        (self.folder / "eye/Dockerfile").write_text(f"FROM {BASE_IMAGE}\nLABEL version={version}\n")

    def rorg(self, *words: str, code: int = 0):
        return rorg(*words, "--manifests", str(self.folder / "tree"), code=code, **self.where)

    def listed(self) -> list[dict]:
        return json.loads(self.rorg("image", "list", "-o", "json").stdout)

    def build(self, version: str) -> str:
        """The reference of what is in force then, which a robot would have used."""
        self.write(version)
        (row,) = [r for r in json.loads(self.rorg("build", "-o", "json").stdout) if r["image"] == self.name]
        Records(self.folder / "state").use([row["reference"]])
        return row["reference"]


@pytest.fixture
def lab(dockerd, tmp_path):
    found = Lab(tmp_path, dockerd.host, "eye-of-the-lab")
    yield found
    import docker

    api = docker.APIClient(dockerd.host, version="auto")
    for row in api.images():
        for tag in row["RepoTags"] or ():
            if plain(tag).startswith(found.name):
                api.remove_image(tag, force=True)


def test_what_a_rollback_may_need_is_kept_and_the_rest_goes(lab):
    one, two, three = lab.build("1"), lab.build("2"), lab.build("3")
    listed = {i["references"][-1] if len(i["references"]) == 1 else three: i for i in lab.listed()}
    assert listed[three]["kept_for"] == ["in force"]
    assert listed[two]["kept_for"] == ["1 revision back"]
    assert listed[one]["kept_for"] == ["2 revisions back"]
    assert "nothing to remove" in lab.rorg("image", "prune", "--yes").stderr
    assert one in lab.rorg("image", "prune", "--keep", "2", "--dry-run").stdout
    assert "try --yes" in lab.rorg("image", "prune", "--keep", "2", code=5).stderr
    assert len(lab.listed()) == 3
    assert "1 image removed" in lab.rorg("image", "prune", "--keep", "2", "--yes").stderr
    assert {r for i in lab.listed() for r in i["references"]} == {two, three, f"{lab.name}:latest"}
    lab.write("2")
    assert "present" in lab.rorg("build", "-o", "json").stdout
    assert "nothing to remove" in lab.rorg("image", "prune", "--keep", "2", "--yes").stderr


def test_a_robots_images_come_to_another_machine_in_a_file(lab, tmp_path):
    one = lab.build("1")
    archive = tmp_path / "robot.tar"
    assert "1 image in" in lab.rorg("image", "save", str(archive)).stderr
    with tarfile.open(archive) as saved:
        assert {RECORDS, "manifest.json"} <= set(saved.getnames())
    lab.write("other")
    lab.build("other")
    lab.write("1")
    lab.rorg("image", "prune", "--keep", "1", "--yes")
    records = Records(tmp_path / "state")
    records.forget([one])
    lab.rorg("image", "load", str(archive))
    (built,) = [b for b in records.built().values() if b.reference == one]
    assert built.name == lab.name
    (row,) = [r for r in json.loads(lab.rorg("build", "-o", "json").stdout) if r["image"] == lab.name]
    assert row["outcome"] == "present"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["paint"], 2, "is not one of 'list', 'prune', 'save', 'load'"),
        (["save"], 2, "rorg image save FILE"),
        (["list", "eye"], 2, "unexpected argument"),
        (["load", "nothing.tar"], 2, "No such file"),
        (["save", "to.tar", "nose"], 2, "nose"),
        (["save", "to.tar"], 2, "rorg build"),
        (["save", "/nowhere/to.tar", "eye-of-the-lab"], 2, "rorg build"),
    ],
)
def test_what_cannot_be_is_told(lab, words, code, said):
    assert said in lab.rorg("image", *words, code=code).stderr


def test_what_is_no_archive_is_told(tmp_path):
    path = tmp_path / "robot.tar"
    for content in (b"", b"x" * 2000):
        path.write_bytes(content)
        with path.open("rb") as file, pytest.raises(Invalid, match="not an archive of images"):
            read_records(file, "robot.tar")


def test_only_images_that_this_robot_built_are_looked_at():
    labels = {LABEL_IMAGE: "eye", LABEL_BUILDER: "me"}
    rows = [
        {"Id": "1", "RepoTags": ["eye:1"], "Labels": labels, "Size": 10, "SharedSize": 4, "Containers": 0},
        {"Id": "2", "RepoTags": ["eye:2"], "Labels": {**labels, LABEL_BUILDER: "you"}, "Size": 1, "SharedSize": 0},
        {"Id": "3", "RepoTags": ["debian:12"], "Labels": None, "Size": 1, "SharedSize": -1},
        {"Id": "4", "RepoTags": None, "Labels": labels, "Size": 10, "SharedSize": 4, "Containers": 2},
    ]
    found = {i.id: i for i in own_images(rows, "me", {"eye:3"}, [["eye:3"], ["eye:2"]], 5)}
    assert set(found) == {"1", "4"}
    assert (found["1"].reasons, found["1"].freed) == ((), 6)
    assert (found["4"].reasons, found["4"].freed) == (("2 containers",), 0)


def test_what_was_written_down_of_images_outlives_whatever_it_is(tmp_path):
    records = Records(tmp_path)
    assert (records.built(), records.revisions()) == ({}, [])
    built = Built("eye", "eye:1", bases={"base": "sha256:0"})
    records.note({"a" * 64: built})
    records.use(["eye:1", "base"])
    records.use(["base", "eye:1"])
    records.use(["eye:2"])
    assert records.built() == {"a" * 64: built}
    assert records.revisions() == [["eye:2"], ["base", "eye:1"]]
    for text in ("", "[]", '{"built": [], "revisions": {}}', '{"built": {"a": 1, "b": {"x": 1}}, "revisions": [1]}'):
        records.path.write_text(text)
        assert (records.built(), records.revisions()) == ({}, [])
        records.note({"b" * 64: built})
        assert records.built() == {"b" * 64: built}
