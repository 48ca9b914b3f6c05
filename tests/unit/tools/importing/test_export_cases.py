"""Each Compose project that is imported goes back: the Compose file of its robot, read again, is the same robot."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from compose_cases import CASES, load_from

from rorg.manifest.load import load
from rorg.model.catalog import Catalog, Service
from rorg.tools.compose import load as read_project
from rorg.tools.compose.project import Project
from rorg.tools.compose.writer import export
from rorg.tools.compose.writer_text import write
from rorg.tools.importing.compose import from_compose

RECORDED = sorted(path.parent for path in CASES.glob("*/inspect.json"))


def imported(project: Project | None, folder: Path, tree: Path) -> Catalog:
    assert project
    made = from_compose(project, tree, folder, lambda p: p.read_text() if p.is_file() else None)
    assert not made.errors
    for path, text in made.texts.items():
        (tree / path).parent.mkdir(parents=True, exist_ok=True)
        (tree / path).write_text(text)
    loaded = load(tree)
    assert loaded.catalog, "\n".join(map(str, loaded.diagnostics))
    return loaded.catalog


def containers(catalog: Catalog) -> dict[str, Any]:
    return {name: _container(service) for name, service in catalog.services.items() if service.spec is not None}


def _container(service: Service) -> dict[str, Any]:
    """Its spec. A service has its own name as an alias: Compose adds that of what was one of several copies."""
    spec = dict(service.spec or {})
    if "networks" in spec:
        spec["networks"] = {
            name: {**said, "aliases": sorted({*said.get("aliases", ()), service.name})}
            for name, said in spec["networks"].items()
        }
    return spec


@pytest.mark.parametrize("case", RECORDED, ids=lambda c: c.name)
def test_what_is_exported_is_the_same_robot(case, tmp_path):
    folder = tmp_path / case.name
    shutil.copytree(case, folder)
    project = load_from(folder, ("*",)).project
    one = imported(project, folder, folder / "manifests")
    exported = export(one, str(folder), case.name)
    for path in folder.glob("*compose*.y*ml"):
        path.unlink()
    (folder / "exported.yaml").write_text(write(exported))
    for name, text in exported.files.items():
        (folder / name).write_text(text)
    read = read_project([folder / "exported.yaml"], {}, env_files=[], profiles=("*",))
    two = imported(read.project, folder, folder / "again")
    assert containers(two) == containers(one)
    for kind in ("networks", "volumes"):
        there = {name: (o.called, o.spec, o.external) for name, o in getattr(two, kind).items()}
        assert there == {name: (o.called, o.spec, o.external) for name, o in getattr(one, kind).items()}
    assert around(two) == around(one)


SHARED = """\
name: bot
services:
  nav: {image: lab/nav, env_file: [robot.env, nav.env]}
  arm: {image: lab/arm, env_file: robot.env, devices: ['nvidia.com/gpu=all', /dev/arm]}
  rviz: {image: lab/rviz, env_file: robot.env, profiles: [tools], depends_on: [nav, tf]}
  tf: {image: lab/tf, profiles: [tools, debug]}
"""


def test_profiles_and_a_shared_file_of_variables_stay(tmp_path):
    (tmp_path / "compose.yaml").write_text(SHARED)
    (tmp_path / "robot.env").write_text("ROBOT=bot\nKEY=a b\n")
    (tmp_path / "nav.env").write_text("MAP=lab\n")
    one = imported(read_project([tmp_path / "compose.yaml"], {}).project, tmp_path, tmp_path / "manifests")
    exported = export(one, str(tmp_path), "bot")
    services = exported.document["services"]
    assert {name: said.get("env_file") for name, said in services.items()} == {
        "nav": ["./shared.env", "./nav.env"],
        "arm": ["./shared.env"],
        "rviz": ["./shared.env"],
        "tf": None,
    }
    assert exported.files == {"shared.env": "KEY='a b'\nROBOT=bot\n", "nav.env": "MAP=lab\n"}
    assert {name: said.get("profiles") for name, said in services.items()} == {
        "nav": None,
        "arm": None,
        "rviz": ["tools"],
        "tf": ["debug", "tools"],
    }
    assert services["arm"]["devices"] == ["/dev/arm", "nvidia.com/gpu=all"]
    assert "deploy" not in services["arm"]
    assert [n.text for n in exported.notes if n.field == "Group"] == [
        "debug: `docker compose --profile debug up --detach`",
        "tools: `docker compose --profile tools up --detach`",
    ]
    (tmp_path / "exported.yaml").write_text(write(exported))
    for name, text in exported.files.items():
        (tmp_path / name).write_text(text)
    two = imported(read_project([tmp_path / "exported.yaml"], {}).project, tmp_path, tmp_path / "again")
    assert containers(two) == containers(one)
    assert two.groups.keys() == one.groups.keys()


def around(catalog: Catalog) -> dict[str, Any]:
    """What is said of services beside their containers."""
    return {
        n: (set(s.needs), s.restarts_with, s.restart, s.ready and s.ready.kind) for n, s in catalog.services.items()
    }
