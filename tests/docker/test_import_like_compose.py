"""What rorg creates of an imported Compose project is what Compose creates of it, by the engine's inspection.

Each of tests/cases/compose with an `inspect.json`, which tests/cases/compose/record_inspect.py has recorded with
Compose itself: its project is imported, the manifests are loaded, and the engine makes their networks, volumes and
containers. Nothing is started.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import agreement
import pytest
from compose_cases import CASES, load_from
from creating import Creator

from rorg.core.desired import desire
from rorg.manifest.load import load
from rorg.model.catalog import Catalog
from rorg.tools.importing.compose import from_compose

pytestmark = pytest.mark.docker
RECORDED = sorted(p.parent for p in CASES.glob("*/inspect.json"))


@pytest.fixture(scope="module")
def creator(dockerd):
    found = Creator(dockerd.host)
    yield found
    found.close()


def imported(case: Path, folder: Path) -> Catalog:
    """The tree that a case becomes, in the folder of its Compose file."""
    found = load_from(folder, profiles=("*",))
    assert found.project, "\n".join(map(str, found.diagnostics))
    tree = folder / "manifests"
    made = from_compose(found.project, tree, folder, _text)
    assert not made.errors, "\n".join(map(str, made.errors))
    for path, text in made.texts.items():
        (tree / path).parent.mkdir(parents=True, exist_ok=True)
        (tree / path).write_text(text)
    loaded = load(tree)
    assert loaded.catalog, "\n".join(map(str, loaded.diagnostics))
    return loaded.catalog


def _text(path: Path) -> str | None:
    return path.read_text() if path.is_file() else None


@pytest.mark.parametrize("case", RECORDED, ids=lambda c: c.name)
def test_both_create_the_same(case, creator, tmp_path):
    folder = tmp_path / case.name
    shutil.copytree(case, folder)
    catalog = imported(case, folder)
    compose = json.loads((case / "inspect.json").read_text())
    rorg = creator.create(desire(catalog), compose["config"], folder)
    found = agreement.differences({k: v for k, v in compose.items() if k != "config"}, rorg)
    meant = agreement.otherwise(case)
    assert [d for d in found if d.partition(": ")[0] not in meant] == []
    assert meant.keys() <= {d.partition(": ")[0] for d in found}, "what is meant to be otherwise is not"
