"""Writes a robot as a Compose file, without its requests: services with all options of their containers, how their
images are built, and the networks and volumes that they name.

An option that a Compose file cannot express becomes a Note, which `rorg export compose` writes into the file as a
comment.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rorg.model.catalog import Catalog, Service
from rorg.model.image_names import declared, stem
from rorg.model.objects import EngineObject, Kind
from rorg.model.ros import PARAMETER_FILE, parameter_file
from rorg.model.run_directory import parameter_folder
from rorg.model.volumes import is_path
from rorg.tools.compose.writer_env_files import env_files
from rorg.tools.compose.writer_images import base_images, build
from rorg.tools.compose.writer_notes import condition, notes_of
from rorg.tools.compose.writer_options import OPTIONS, SOCKET, Writing
from rorg.tools.compose.writer_profiles import profiles
from rorg.tools.compose.writer_text import Exported

RESTART = {"always": "unless-stopped", "on-failure": "on-failure"}
"""rorg's `restart` -> that of Compose. `never` has none."""
BUILD = "build"
"""The profile of images that only other images are based on."""


def export(catalog: Catalog, base: str, name: str) -> Exported:
    """The whole robot. `base`: absolute directory of the Compose file; paths below it or its parent are written
    relative to it. `name`: any text, from which the project's name is made."""
    services = {n: s for n, s in sorted(catalog.services.items()) if s.spec is not None}
    containers = {s.container_name: n for n, s in services.items()}
    networks = sections("network", catalog.networks, services.values())
    volumes = sections("volume", catalog.volumes, services.values())
    document: dict[str, Any] = {"name": project(name), "services": {}}
    notes, files = list(notes_of(catalog)), dict[str, str]()
    secrets = env_files({n: values for n, s in services.items() if (values := _secrets(s))})
    groups = profiles(catalog)
    for service in services.values():
        writing = Writing(service.name, containers, _keys(networks), _keys(volumes), base)
        _write_secrets(writing, secrets.get(service.name, {}))
        if service.name in groups:
            writing.put("profiles", groups[service.name])
        document["services"][service.name] = _service(writing, service, catalog)
        notes += writing.notes
        files |= writing.files
    for image in base_images(catalog, services):
        document["services"][f"image-{stem(image.name)}"] = {
            "image": image.name,
            "build": build(image, catalog.images, base),
            "profiles": [BUILD],
        }
    document |= {k: v for k, v in (("networks", networks), ("volumes", volumes)) if v}
    return Exported(document, tuple(notes), files, {n: s.description for n, s in services.items() if s.description})


def project(name: str) -> str:
    """A valid name of a Compose project: lower-case letters, digits, - and _, starting with a letter or digit."""
    return re.sub(r"^[^a-z0-9]+", "", re.sub(r"[^a-z0-9_-]+", "-", name.lower())) or "robot"


def _service(writing: Writing, service: Service, catalog: Catalog) -> Mapping[str, Any]:
    spec = {"container_name": service.name, **service.options}
    if secrets := _secrets(service):
        spec["environment"] = {k: v for k, v in spec["environment"].items() if k not in secrets}
    _write_parameters(writing, service, spec)
    if "restart" not in spec and service.restart in RESTART:
        spec["restart"] = RESTART[service.restart]
    if spec.get("network_disabled"):
        spec = {k: v for k, v in spec.items() if k not in ("network_mode", "networks")}
    if not spec.keys() & {"network_mode", "networks", "network_disabled"}:
        spec["network_mode"] = "bridge"
    for option in sorted(spec):
        OPTIONS[option](writing, option, spec[option])
    if "deploy" in writing.section and "mem_reservation" in spec:  # Compose wants both to agree
        writing.section["deploy"]["resources"]["reservations"]["memory"] = str(spec["mem_reservation"])
    if SOCKET in spec.get("environment", {}):
        writing.note("may_request", "rorg does not run here, so its socket and RORG_SOCKET are left out")
    image = catalog.images.get(declared(str(spec["image"]), catalog.images))
    if image is not None:
        writing.put("image", image.name)
        if image.context is not None:
            writing.put("build", build(image, catalog.images, writing.base))
    if needs := _needs(service, catalog):
        writing.put("depends_on", needs)
    return _ordered(writing.section)


def _secrets(service: Service) -> dict[str, str]:
    """The secret variables of its environment, with their values."""
    return {k: v for k, v in service.options.get("environment", {}).items() if k in service.secrets}


def _write_secrets(writing: Writing, files: Mapping[str, Mapping[str, str]]) -> None:
    """Refers to files of variables, and writes them."""
    for file, values in files.items():
        writing.files[file] = dotenv(values)
        writing.note("secrets", f"{', '.join(sorted(values))}: in {file}, which is secret", lost=False)
    if files:
        writing.put("env_file", [f"./{file}" for file in files])


PARAMETERS = "/ros-parameters.yaml"
"""In the container: parameters of ROS 2, which rorg has in a file of its own."""


def _write_parameters(writing: Writing, service: Service, spec: dict[str, Any]) -> None:
    """Writes parameters of ROS 2 as a file, which the container mounts instead of rorg's."""
    if service.ros is None or service.domain is None:
        return
    folder, name = parameter_folder(service.name), f"{service.name}.parameters.yaml"
    writing.files[name] = parameter_file(service.ros.values)
    writing.note("ros.parameters", f"{name}; a change needs a new container", lost=False)
    mounts = [volume for volume in spec["volumes"] if volume != f"{folder}:{folder}:ro"]
    spec["volumes"] = [*mounts, f"{writing.base}/{name}:{PARAMETERS}:ro"]
    spec["command"] = [PARAMETERS if word == f"{folder}/{PARAMETER_FILE}" else word for word in spec["command"]]


FIRST = ("image", "build", "container_name", "command", "entrypoint", "depends_on")


def _ordered(section: Mapping[str, Any]) -> dict[str, Any]:
    return {k: section[k] for k in (*FIRST, *sorted(section.keys() - set(FIRST))) if k in section}


def _needs(service: Service, catalog: Catalog) -> dict[str, Any]:
    """The needs of a service. A meta-service has no container, so its own needs replace it."""
    needs: dict[str, Any] = {}
    pending, seen = list(service.needs), set[str]()
    while pending:
        name = pending.pop(0)
        other = catalog.services.get(name)
        if other is None or name in seen:
            continue
        seen.add(name)
        if other.spec is None:
            pending += other.needs
            continue
        restart = {"restart": True} if name in service.restarts_with else {}
        needs[name] = {"condition": condition(other.ready), **restart}
    return dict(sorted(needs.items()))


def _keys(section: Mapping[str, Any]) -> dict[str, str]:
    """The engine's name -> the key in the Compose file."""
    return {one["name"]: key for key, one in section.items()}


_PLAIN = re.compile(r"[A-Za-z0-9_./:@%+,=-]*")
_ESCAPES = {"\\": "\\\\", '"': '\\"', "$": "\\$", "\n": "\\n", "\r": "\\r", "\t": "\\t"}


def dotenv(values: Mapping[str, str]) -> str:
    """One line for each value, quoted if Compose would otherwise change it."""
    return "".join(f"{name}={_quoted(value)}\n" for name, value in sorted(values.items()))


def _quoted(value: str) -> str:
    if _PLAIN.fullmatch(value):
        return value
    if "'" not in value and "\n" not in value and "\r" not in value and "\\" not in value:
        return f"'{value}'"
    return '"' + "".join(_ESCAPES.get(sign, sign) for sign in value) + '"'


ENGINES_OWN = ("host", "none", "bridge", "default")
"""Networks that always exist."""


def sections(kind: Kind, declared: Mapping[str, EngineObject], services: Iterable[Service]) -> dict[str, Any]:
    """All declared objects, by their names in the tree, and all others that services name, by the engine's names. Such
    a network must exist already; a volume is created if it is missing."""
    objects = {name: _declared(one) for name, one in declared.items()}
    known = {one.called for one in declared.values()}
    named = _networks if kind == "network" else _volumes
    for name in sorted({name for service in services for name in named(service.options)} - known):
        key = name if name not in objects else f"{name}-external"
        objects[key] = {"name": name, "external": True} if kind == "network" else {"name": name}
    return dict(sorted(objects.items()))


def _declared(one: EngineObject) -> dict[str, Any]:
    return {"name": one.called, "external": True} if one.external else {"name": one.called, **one.spec}


def _networks(spec: Mapping[str, Any]) -> Iterator[str]:
    """Networks that a container joins. A network_mode needs no declaration here: Compose passes it on."""
    yield from (name for name in spec.get("networks") or () if name not in ENGINES_OWN)


def _volumes(spec: Mapping[str, Any]) -> Iterator[str]:
    for value in spec.get("volumes", ()):
        if isinstance(value, Mapping):
            name = (value.get("source") or "") if value["type"] == "volume" else ""
        else:
            name = value.partition(":")[0] if ":" in value else ""
        if name and not is_path(name) and not name.startswith("$"):
            yield name
