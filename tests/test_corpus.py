"""Projects in the manner of public robots: each import that ends with exit code 0 is valid (`make corpus`)."""

from __future__ import annotations

import os

import commands
import corpus
import pytest

ALL = corpus.samples()
WRITTEN = [sample for sample in ALL if sample.folder is None]
EXIT_CODES = {"valid": 0, "invalid": 2, "refused": 2}


def test_the_corpus_is_large_and_each_name_is_used_once():
    assert len(ALL) >= 150
    assert len({sample.name for sample in ALL}) == len(ALL)


@pytest.mark.parametrize("sample", WRITTEN, ids=lambda sample: sample.name)
def test_a_project_has_its_outcome(sample, tmp_path):
    sample.write(tmp_path)
    found = corpus.outcome(sample, tmp_path)
    assert found.how == sample.expected, found.why


@pytest.mark.parametrize("sample", WRITTEN[::12], ids=lambda sample: sample.name)
def test_exit_code_0_means_that_validate_passes(sample, tmp_path):
    sample.write(tmp_path)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RORG_")}
    done = commands.run(["import", *sample.words], environment, tmp_path)
    assert done.returncode == EXIT_CODES[sample.expected], done.stderr
    if sample.expected != "refused":
        assert commands.run(["validate", "manifests"], environment, tmp_path).returncode == done.returncode
    assert (tmp_path / "manifests").exists() == (sample.expected != "refused")
