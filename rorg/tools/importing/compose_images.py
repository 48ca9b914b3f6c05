"""What Compose builds, as manifests of kind Image: one for each image, however many services run it."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rorg.host.git_process import git_command
from rorg.model.image_names import NAME, plain, stem
from rorg.tools.compose.forms import is_remote
from rorg.tools.importing.compose_keys import BUILD
from rorg.tools.importing.compose_work import Work, nonempty
from rorg.tools.importing.manifests import Made

REFERENCES = ("docker-image://", "image:")


def images(work: Work) -> tuple[list[Made], dict[str, str]]:
    """The Images, and the image that each service runs. If two services build the same name in different ways, each
    gets an Image of its own: under Compose, both run the one that was built last."""
    made: dict[str, Made] = {}
    used: dict[str, str] = {}
    wanted = {name: _name(work, name, said) for name, said in work.project.services.items()}
    for name, said in work.project.services.items():
        used[name] = wanted[name]
        if not said.get("build"):
            continue
        before = len(work.found)
        if is_remote(context := str(said["build"].get("context") or "")):
            place = ("services", name, "build", "context")
            work.refuse(f"rorg cannot build from {context}", *place, remedy="a clone of it beside the manifests")
            used[name], work.unbuilt[name] = said.get("image") or wanted[name], work.told(before)
            continue
        if why := _not_here(said["build"]):
            used[name] = said.get("image") or wanted[name]
            _use_ready_made(work, name, used[name] if said.get("image") else "", why)
            work.unbuilt[name] = work.told(before)
            continue
        image = _image(work, name, wanted[name], wanted)
        other = made.get(image.name)
        if other is not None and dict(other.spec) != dict(image.spec):
            own = _own_name(work, name)
            message = f"another service builds the image {image.name} differently, so this one becomes {own}"
            work.note(message, "services", name, "build")
            image, used[name] = Made("Image", own, image.spec, image.comments), own
        if not re.fullmatch(NAME, image.name):
            message = f"'{image.name}' is not a valid name of an Image"
            work.refuse(message, "services", name, "image", remedy="a name in lower case, with or without a tag")
            continue
        made.setdefault(image.name, image)
    return list(made.values()), used


def _not_here(said: Mapping[str, Any]) -> str:
    """Why a build cannot work on this machine; empty if it can."""
    context = str(said.get("context") or "")
    if not os.path.isdir(context):
        return f"the build context {context} is missing"
    file = os.path.join(context, str(said.get("dockerfile") or "Dockerfile"))
    return "" if said.get("dockerfile_inline") or os.path.isfile(file) else f"there is no {file}"


def _use_ready_made(work: Work, name: str, image: str, why: str) -> None:
    """Reports that nothing builds the image of a service, which must then be on the machine or in a registry."""
    place = ("services", name, "build", "context")
    remedy = f"to run `{git_command(work.top, 'submodule', 'update', '--init')}` if it is a submodule, and import again"
    if image:
        work.warn(
            f"{why}, so nothing builds {image}: it must be on this machine or in a registry", *place, remedy=remedy
        )
    else:
        work.refuse(f"{why}, and {name} names no image", *place, remedy=remedy)


def _own_name(work: Work, service: str) -> str:
    """The tag that Compose gives to a build without `image`."""
    return re.sub(r"[^a-z0-9]+$|[^a-z0-9._-]", "", f"{work.project.name}-{service}".lower())


def _name(work: Work, name: str, said: Mapping[str, Any]) -> str:
    """The image of a service. A built one gets the shortest name that means the same on this machine."""
    if not said.get("build"):
        return str(said.get("image") or "")
    return plain(said["image"]).lower() if said.get("image") else _own_name(work, name)


def _image(work: Work, name: str, image: str, wanted: Mapping[str, str]) -> Made:
    said: Mapping[str, Any] = work.project.services[name]["build"]
    place, before = ("services", name, "build"), len(work.found)
    work.check(BUILD, said, *place, shown="build.")
    context = str(said.get("context") or work.project.directory)
    _warn_of_manifests(work, image, context, place)
    dockerfile, platforms = _dockerfile(work, image, context, said), said.get("platforms") or []
    if len(platforms) > 1:
        message = "build.platforms: rorg builds an image for only one platform"
        work.refuse(message, *place, "platforms", remedy="the robot's, or none for the platform of the machine")
    spec = {
        "context": work.local(context, "images"),
        "dockerfile": dockerfile if dockerfile != "Dockerfile" else "",
        "args": _args(work, said.get("args") or {}, place),
        "target": said.get("target"),
        "cache_from": said.get("cache_from"),
        "additional_contexts": _contexts(work, said.get("additional_contexts") or {}, wanted, place),
        "platform": "".join(platforms[:1]),
    }
    comments = (f"From {work.origin(*place)}, service {name}.", *work.told(before))
    return Made("Image", image, nonempty(spec), comments)


def _warn_of_manifests(work: Work, image: str, context: str, place: tuple[str, ...]) -> None:
    """Warns if the manifests are part of the build context, so that editing them changes the image."""
    if context != str(work.tree) and not f"{work.tree}/".startswith(f"{context}/"):
        return
    inside = os.path.relpath(work.tree, context)
    ignored = (work.read(Path(context) / ".dockerignore") or "").split()
    if not {inside, f"{inside}/", f"/{inside}", f"**/{inside}"} & set(ignored):
        message = f"the manifests are in the context of {image}, so every change of them rebuilds it"
        work.warn(message, *place, "context", remedy=f"a line '{inside}' in {context}/.dockerignore")


def _dockerfile(work: Work, image: str, context: str, said: Mapping[str, Any]) -> str:
    """The path in an Image: in the context, or relative to it."""
    if said.get("dockerfile_inline"):
        path = f"dockerfiles/{stem(image)}.Dockerfile"
        work.files[path] = said["dockerfile_inline"]
        return os.path.relpath(work.tree / path, context)
    written = str(said.get("dockerfile") or "")
    return os.path.relpath(written, context) if written.startswith("/") else written


def _args(work: Work, said: Mapping[str, Any], place: tuple[str, ...]) -> dict[str, str]:
    for name, value in said.items():
        if value is None:
            work.note(f"build.args.{name} is not set anywhere, so it is left out", *place, "args", name)
    return {name: str(value) for name, value in said.items() if value is not None}


def _contexts(work: Work, said: Mapping[str, str], wanted: Mapping[str, str], place: tuple[str, ...]) -> dict[str, str]:
    contexts = {}
    for name, value in said.items():
        if value.startswith("service:"):
            contexts[name] = wanted.get(value.removeprefix("service:"), value)
        elif is_remote(value) and not value.startswith(REFERENCES):
            message = f"build.additional_contexts.{name}: rorg cannot build from {value}"
            work.refuse(message, *place, "additional_contexts", name, remedy="a clone of it beside the manifests")
        else:
            contexts[name] = value if value.startswith(REFERENCES) else work.local(value, "images")
    return contexts
