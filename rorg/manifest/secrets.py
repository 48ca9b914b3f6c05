"""Finds the secret values of a tree: those that Services name, and those from files of variables."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rorg.manifest.documents import Source, manifest_files
from rorg.manifest.files import read_text
from rorg.manifest.yaml_documents import read_documents
from rorg.manifest.yaml_source import Document
from rorg.model.catalog import SHORTEST_SECRET, Image, Service
from rorg.model.diagnostics import Diagnostic, Reading, nearest
from rorg.model.image_names import declared


def secrets_of(
    services: Mapping[str, Service],
    images: Mapping[str, Image],
    sources: Mapping[str, Source],
    doubtful: Collection[str] = (),
) -> Reading[dict[str, Image]]:
    """Marks build arguments as secret if a service that uses the Image declares them secret. A name that does not exist
    is an error: it is probably misspelt and hides nothing. A `doubtful` service may lack variables because of a mistake
    elsewhere. A value that is too short to be found in other text is a warning."""
    marked_images = dict(images)
    for name, source in sources.items():
        service = services[name]
        variables = service.options.get("environment", {})
        under = _under(str(service.options.get("image", "")), images)
        for index, secret in enumerate(source.spec.secrets):
            where = source.where("spec", "secrets", index)
            taken = [i for i in under if secret in images[i].args]
            for image in taken:
                marked_images[image] = replace(
                    marked_images[image], secrets=tuple(sorted({*marked_images[image].secrets, secret}))
                )
            values = [*([variables[secret]] if secret in variables else []), *(images[i].args[secret] for i in taken)]
            if not values and name in doubtful:
                continue
            if not values:
                known = {*variables, *(a for i in under for a in images[i].args)}
                remedy = nearest(secret, known) or "to name one that is in container.environment or an env_file"
                message = f"'{secret}' is neither a variable of '{name}' nor an argument of its image"
                yield Diagnostic(where, message, remedy)
            elif any(0 < len(value) < SHORTEST_SECRET for value in values):
                message = f"the value of '{secret}' is too short to be hidden where it is part of other text"
                remedy = f"one of at least {SHORTEST_SECRET} characters"
                yield Diagnostic(where, message, remedy, "warning")
    return marked_images


def _under(image: str, images: Mapping[str, Image]) -> list[str]:
    """The Image of a reference, and all Images below it."""
    names: list[str] = []
    pending = [image]
    while pending:
        name = declared(pending.pop(), images)
        if name and name not in names:
            names.append(name)
            pending += images[name].bases
    return names


def unread_secrets(root: Path, overlay: Mapping[Path, str | None], broken: Collection[str]) -> dict[str, Service]:
    """Secrets of manifests that are invalid on their own, as services that have nothing else."""
    services: dict[str, Service] = {}
    for path in manifest_files(root):
        with contextlib.suppress(OSError):
            text = overlay.get(path) or read_text(path, root)
            documents = read_documents(text, str(path)) if path.stem in broken or "\n---" in text else []
            for number, (_, document, _) in enumerate(documents):
                services |= _unread(f"{path.stem}?{number or ''}", path.stem, document)
    return services


def _unread(key: str, name: str, document: Document | None) -> dict[str, Service]:
    with contextlib.suppress(TypeError, AttributeError, LookupError, ValueError):
        spec: Any = document.value["spec"] if document else {}
        said = spec["container"]["environment"]
        pairs = said.items() if isinstance(said, dict) else (entry.split("=", 1) for entry in said)
        environment = {str(name): str(value) for name, value in pairs}
        secrets = tuple(name for name in environment if name in spec["secrets"])
        return {key: Service(name, spec={"environment": environment}, secrets=secrets)}
    return {}
