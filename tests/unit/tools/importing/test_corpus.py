"""Projects in the manner of public robots: each import that ends with exit code 0 is valid (`make corpus`)."""

from __future__ import annotations

import corpus
import pytest
from corpus_samples import ALL, WRITTEN


def test_the_corpus_is_large_and_each_name_is_used_once():
    assert len(ALL) >= 150
    assert len({sample.name for sample in ALL}) == len(ALL)


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    def outcome(sample: corpus.Sample) -> corpus.Outcome:
        folder = tmp_path_factory.mktemp(sample.name)
        sample.write(folder)
        return corpus.outcome(sample, folder)

    return {sample.name: outcome(sample) for sample in WRITTEN}


@pytest.mark.slow
@pytest.mark.parametrize("sample", WRITTEN, ids=lambda sample: sample.name)
def test_a_project_has_its_outcome(sample, outcomes):
    assert outcomes[sample.name].how == sample.expected, outcomes[sample.name].why


@pytest.mark.slow
def test_warnings_are_few_enough_to_be_read(outcomes):
    """Of all that import does not ask about. More than 0.7 a service is noise, in which the true ones are lost."""
    warnings, services = (sum(getattr(one, kind) for one in outcomes.values()) for kind in ("warnings", "services"))
    assert services > 150
    assert 0.3 < warnings / services < 0.7
