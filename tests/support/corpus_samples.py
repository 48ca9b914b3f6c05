"""The samples of the corpus, and what is written of each."""

from __future__ import annotations

import corpus

ALL = corpus.samples()

WRITTEN = [sample for sample in ALL if sample.folder is None]
