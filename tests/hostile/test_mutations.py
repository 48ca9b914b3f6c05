"""Whatever a file says: what is wrong with it is said, at its place, soon; never a traceback."""

from __future__ import annotations

import copy
import random

import pytest
import yaml
from fuzzing import Case, fuzz
from mutated_trees import REQUESTS, a_tree, is_planned, placeless
from mutations import mutated_text, mutated_value

from rorg.core.desired import desire
from rorg.host.contents import Contents
from rorg.manifest.documents import UNEXPECTED
from rorg.manifest.load import load
from rorg.store.requests_parser import parse, render


def mutation(texts: list[str], chance: random.Random) -> tuple[int, str]:
    """(which of the texts, what becomes of it)"""
    which = chance.randrange(len(texts))
    if chance.random() < 0.4:
        return which, mutated_text(texts[which], chance)
    value = copy.deepcopy(yaml.safe_load(texts[which]))
    for _ in range(chance.choice((1, 1, 1, 3))):
        value = mutated_value(value, chance)
    return which, yaml.safe_dump(value, allow_unicode=chance.random() < 0.5)


@pytest.mark.slow
@pytest.mark.fuzz
def test_mutated_manifests_are_read_or_refused_with_their_place(tmp_path):
    root = a_tree(tmp_path)
    assert not load(root).errors
    folders = [root / folder for folder in ("policies", "profiles", "images")]
    paths = [root / "services" / "rich.yaml", *(path for folder in folders for path in folder.glob("*.yaml"))]
    texts = [path.read_text() for path in paths]

    def attempt(case: Case) -> None:
        which, case.text = mutation(texts, case.chance)
        paths[which].write_bytes(case.text.encode("utf-8", errors="surrogateescape"))
        try:
            found = load(root)
            if found.catalog is not None:
                desire(found.catalog, str(root), Contents().of(found.catalog, root))
                if not case.number % 5:
                    is_planned(found.catalog)
        finally:
            paths[which].write_text(texts[which])
        assert found.catalog is not None or found.errors
        unexpected = [str(d) for d in found.errors if UNEXPECTED in d.message]
        assert not unexpected, unexpected

    fuzz("manifests", 300, attempt)


@pytest.mark.fuzz
def test_mutated_requests_files_are_read_or_refused_and_written_as_they_are_read():
    def attempt(case: Case) -> None:
        _, case.text = mutation([REQUESTS], case.chance)
        document, diagnostics = parse(case.text, "requests.yaml")
        assert document is not None or diagnostics
        assert document is None or placeless(parse(render(document), "requests.yaml")[0]) == placeless(document)

    fuzz("requests", 300, attempt)
