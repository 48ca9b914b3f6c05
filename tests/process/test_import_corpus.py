"""Each import of the corpus that ends with exit code 0 passes `rorg validate`."""

from __future__ import annotations

import os

import commands
import pytest
from corpus_samples import WRITTEN

EXIT_CODES = {"valid": 0, "invalid": 2, "refused": 2}


@pytest.mark.slow
@pytest.mark.parametrize("sample", WRITTEN[::12], ids=lambda sample: sample.name)
def test_exit_code_0_means_that_validate_passes(sample, tmp_path):
    sample.write(tmp_path)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("RORG_")}
    done = commands.run(["import", *sample.words], environment, tmp_path)
    assert done.returncode == EXIT_CODES[sample.expected], done.stderr
    if sample.expected != "refused":
        assert commands.run(["validate", "manifests"], environment, tmp_path).returncode == done.returncode
    assert (tmp_path / "manifests").exists() == (sample.expected != "refused")
