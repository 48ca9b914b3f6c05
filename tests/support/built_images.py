"""What is in images that tests build."""

from __future__ import annotations

import io
import tarfile

import pytest
from image_trees import Place

TAG = "0123456789ab"
"""Of the references that the tests build."""

BOTH = pytest.mark.parametrize("place", ["buildkit", "classic"], indirect=True)


def files_of(place: Place, reference: str) -> dict[str, tuple[tarfile.TarInfo, bytes]]:
    """What an image holds, by path."""
    api = place.engine.api()
    made = api.create_container(reference, ["x"])["Id"]
    try:
        archive = io.BytesIO(b"".join(api.export(made)))
    finally:
        api.remove_container(made)
        api.close()
    with tarfile.open(fileobj=archive) as tar:
        return {m.name: (m, tar.extractfile(m).read() if m.isfile() else b"") for m in tar if not m.islnk()}
