"""Images of a tree that is written on the spot."""

from __future__ import annotations

from pathlib import Path

from robots import write_tree

from rorg.manifest.load import Loaded, load
from rorg.model.image_names import stem


def images(folder: Path, dockerfiles: dict[str, str], services: dict | None = None, **specs: str) -> Loaded:
    """A tree with an Image for each Dockerfile; `specs` are lines of YAML for the spec, by name."""
    write_tree(folder / "tree", {"camera": {}} if services is None else services)
    (folder / "tree/images").mkdir(exist_ok=True)
    for name, text in dockerfiles.items():
        context = folder / stem(name)
        context.mkdir(exist_ok=True)
        (context / "Dockerfile").write_text(text)
        (folder / f"tree/images/{stem(name)}.yaml").write_text(
            f"apiVersion: rorg/v1\nkind: Image\nmetadata: {{name: '{name}'}}\nspec:\n"
            f"  context: ../../{stem(name)}\n{specs.get(stem(name), '')}"
        )
    return load(folder / "tree")
