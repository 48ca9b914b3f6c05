"""Whatever a stranger's project says: what is wrong with it is told, soon, in little memory; never a traceback."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from fuzzing import Case, fuzz
from import_inputs import (
    LAUNCH2_WORDS,
    LAUNCH_WORDS,
    LAUNCHES,
    LAUNCHES2,
    PROJECT,
    PROJECT_WORDS,
    UNIT_WORDS,
    UNITS,
    is_whole,
)
from project_mutations import mutated_project
from robots import write_tree

from rorg.errors import RorgError
from rorg.images.context import context_files
from rorg.images.docker import dockerfile_of
from rorg.images.order import Order
from rorg.manifest.documents import UNEXPECTED
from rorg.manifest.files import Reader
from rorg.manifest.load import load
from rorg.tools.compose.load import load as load_project
from rorg.tools.importing.compose import from_compose
from rorg.tools.importing.roslaunch import from_roslaunch
from rorg.tools.importing.systemd import from_systemd

DOCKERFILE = """\
# syntax=docker/dockerfile:1
ARG BASE=base
ARG TAG=${BASE:-x}-1
FROM --platform=$TARGETPLATFORM ${BASE}:${TAG#x} AS build
ARG A
ENV B="c d" E=f
RUN --mount=type=bind,from=tools,source=/a,target=/b make \\
  # a comment
  all
COPY --from=build --chown=1:1 ["/a b", "/c"]
RUN <<EOF
echo hello
EOF
FROM scratch AS run
COPY --from=0 /x /y
ONBUILD RUN true
"""
DOCKERFILES = {"Dockerfile": DOCKERFILE, ".dockerignore": "# not these\n**/*.pyc\n!a/**/b.pyc\nbuild/*\n[a-c]?/*.o\n"}
DOCKERFILE_WORDS = (
    "${A", "${A:-${B:-", "${A#*", "${A%%*?*?*}", "${A//*/x}", "$", "\\", "<<EOF", "<<-'A B'", "FROM build",
    "FROM ${TAG}", "# escape=`", "# syntax=x", "COPY --from=run /a /b", "COPY --from=99 a b", "--mount=from=$A",
    '["', "ONBUILD FROM x", "**/", "**", "[", "[]", "[^a]", "!", "*?", "\\", "../", "/", "ARG TAG=${TAG}${TAG}",
    "ARG A=${A}${A}", "HEALTHCHECK",
)  # fmt: skip
VARIABLES = {
    "robot.env": '# lab\nMAP=lab\nexport PLACE="${MAP}\\n\\"x\\""\nNAME=\'a $b\'\nBOTH: ${MAP:-x}${PLACE}\nBARE\n',
    "robots/r2/robot.env": "MAP=hall\nWIDE='two\nlines'\n",
}
VARIABLE_WORDS = (
    "${MAP", "${MAP:-${PLACE:-", "${MAP:?no}", "${MAP:+", "$$", "$MAP", "'", '"', "\\", "\\0777", "=", ":", " #",
    "export ", "MAP=${MAP}${MAP}", "PLACE=$PLACE$PLACE$MAP", 'A="', "B='", "a b=c", "\r", "\x85", "\ufeff", "é=1",
    "A.B-C[0]=d",
)  # fmt: skip


def projects(folder: Path, files: dict[str, str], words: tuple[str, ...], attempt: Callable[[Case], None]):
    """An attempt on a project in a folder, of which one file is mutated."""
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)

    def one(case: Case) -> None:
        name, text = mutated_project(files, words, case.chance)
        content = text.encode("utf-8", errors="surrogatepass")
        case.text = f"{name}\n".encode() + content
        (folder / name).write_bytes(content)
        try:
            attempt(case)
        finally:
            (folder / name).write_text(files[name])

    return one


@pytest.mark.slow
@pytest.mark.fuzz
def test_mutated_launch_files_are_imported_or_refused(tmp_path):
    def attempt(case: Case) -> None:
        imported = from_roslaunch(tmp_path / "nav.launch", Reader(tmp_path), {"map": "m"})
        is_whole(imported, tmp_path, case.number)

    fuzz("launches", 60, projects(tmp_path, LAUNCHES, LAUNCH_WORDS, attempt))


@pytest.mark.fuzz
def test_mutated_launch_files_of_ros_2_are_imported_or_refused(tmp_path):
    def attempt(case: Case) -> None:
        skip = case.number % 2 == 0
        imported = from_roslaunch(tmp_path / "nav.launch.xml", Reader(tmp_path), {"map": "m"}, ros=2, skip=skip)
        is_whole(imported, tmp_path, case.number)

    fuzz("launches2", 60, projects(tmp_path, LAUNCHES2, LAUNCH2_WORDS, attempt))


@pytest.mark.fuzz
def test_mutated_units_are_imported_or_refused(tmp_path):
    def attempt(case: Case) -> None:
        read = Reader(tmp_path)
        try:
            texts = {tmp_path / name: read(tmp_path / name) for name in UNITS}
        except OSError:
            return
        is_whole(from_systemd(texts, "", tmp_path / "manifests"), tmp_path, case.number)

    fuzz("units", 60, projects(tmp_path, UNITS, UNIT_WORDS, attempt))


@pytest.mark.slow
@pytest.mark.fuzz
def test_mutated_compose_projects_are_imported_or_refused(tmp_path):
    def attempt(case: Case) -> None:
        read = Reader(tmp_path)
        loaded = load_project([tmp_path], {"HOME": "/home/x"}, read, profiles=["*"])
        assert (loaded.project is None) == bool(loaded.errors)
        if loaded.project is not None:
            imported = from_compose(loaded.project, tmp_path / "manifests", tmp_path, lambda _: None)
            is_whole(imported, tmp_path, case.number)

    fuzz("projects", 60, projects(tmp_path, PROJECT, PROJECT_WORDS, attempt))


@pytest.mark.fuzz
def test_mutated_dockerfiles_are_read_or_refused_with_their_place(tmp_path):
    spec = {"context": "./image", "args": {"A": "b"}, "target": "run"}
    write_tree(tmp_path, {"camera": {"image": "eye"}})
    (tmp_path / "images" / "image").mkdir(parents=True)
    (tmp_path / "images" / "image" / "a").mkdir()
    (tmp_path / "images" / "image" / "a" / ("b" * 200)).touch()
    (tmp_path / "images" / "eye.yaml").write_text(
        f"apiVersion: rorg/v1\nkind: Image\nmetadata: {{name: eye}}\nspec: {spec}\n"
    )

    def attempt(_: Case) -> None:
        found = load(tmp_path)
        assert found.catalog is not None or found.errors
        assert not [d for d in found.errors if UNEXPECTED in d.message]
        if found.catalog is None:
            return
        image = found.catalog.images["eye"]
        try:
            dockerfile_of(Order("eye", image), image, True)
            list(context_files(Path(image.context or ""), image.dockerfile))
        except (OSError, RorgError):
            return

    fuzz("dockerfiles", 60, projects(tmp_path / "images" / "image", DOCKERFILES, DOCKERFILE_WORDS, attempt))


@pytest.mark.fuzz
def test_mutated_files_of_variables_are_read_or_refused_with_their_place(tmp_path):
    environment = {"PLACE": "${PLACE}", "MAP": "${MAP:-none}", "BOTH": "${BOTH}"}
    write_tree(tmp_path, {"camera": {"container": {"environment": environment}}})

    def attempt(case: Case) -> None:
        found = load(tmp_path, robot="r2" if case.number % 2 else "")
        assert found.catalog is not None or found.errors
        assert not [d for d in found.errors if UNEXPECTED in d.message]

    fuzz("variables", 60, projects(tmp_path, VARIABLES, VARIABLE_WORDS, attempt))
