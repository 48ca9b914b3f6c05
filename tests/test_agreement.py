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
from conftest import ROOT
from creating import Creator

from rorg.compose import load as load_project
from rorg.core.desired import desire
from rorg.importing.compose import from_compose
from rorg.manifest.load import load
from rorg.model.catalog import Catalog

pytestmark = pytest.mark.docker
CASES = sorted(p.parent for p in (ROOT / "tests/cases/compose").glob("*/inspect.json"))


@pytest.fixture(scope="module")
def creator(dockerd):
    found = Creator(dockerd.host)
    yield found
    found.close()


def imported(case: Path, folder: Path) -> Catalog:
    """The tree that a case becomes, in the folder of its Compose file."""
    variables = agreement.environment(case)
    found = load_project([folder], variables, profiles=("*",))
    assert found.project, "\n".join(map(str, found.diagnostics))
    tree = folder / "manifests"
    made = from_compose(found.project, tree, folder, variables, _text)
    assert not made.errors, "\n".join(map(str, made.errors))
    for path, text in made.texts.items():
        (tree / path).parent.mkdir(parents=True, exist_ok=True)
        (tree / path).write_text(text)
    loaded = load(tree)
    assert loaded.catalog, "\n".join(map(str, loaded.diagnostics))
    return loaded.catalog


def _text(path: Path) -> str | None:
    return path.read_text() if path.is_file() else None


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_both_create_the_same(case, creator, tmp_path):
    folder = tmp_path / case.name
    shutil.copytree(case, folder)
    catalog = imported(case, folder)
    compose = json.loads((case / "inspect.json").read_text())
    rorg = creator.create(desire(catalog), compose["config"], folder)
    assert agreement.differences({k: v for k, v in compose.items() if k != "config"}, rorg) == []
