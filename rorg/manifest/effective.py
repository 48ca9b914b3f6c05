"""The effective values of one service, each with its source: manifest, profile, Policy, file of variables, or
default."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from rorg.manifest.container import ContainerOptions
from rorg.manifest.container_files import seccomp_file, variables_of
from rorg.manifest.documents import Source, read_tree
from rorg.manifest.effective_values import NOT_SHOWN, Level, Value
from rorg.manifest.field_texts import FieldText, fields_of, inline, written
from rorg.manifest.load import load_or_raise
from rorg.manifest.long_forms import read_env_files
from rorg.manifest.profiles import COMMON, Merged, built_in_profiles, declared, merge_profiles
from rorg.manifest.rendered_container import CALLS, absolute, parts, substitute, values_of
from rorg.manifest.ros import Ros
from rorg.manifest.service import ServiceSpec
from rorg.model.catalog import Service
from rorg.model.diagnostics import collected
from rorg.model.secret_names import secret_texts

AT = ("spec", "container")
UNSAID = (("failures", 0), ("atomic", ""))
"""Values of a Service that mean "not set"."""


def effective(root: Path, name: str, robot: str = "") -> list[Value]:
    """All effective values of a service, on a robot; empty if the service does not exist. Raises Invalid."""
    service = load_or_raise(root, robot=robot).services.get(name)
    sources, _ = collected(read_tree(root, robot=robot))[0]
    own = next((s for s in sources if s.kind == "Service" and s.name == name), None)
    if service is None or own is None:
        return []
    profiles = built_in_profiles() | {s.name: s for s in sources if s.kind == "Profile"}
    merged, _ = collected(merge_profiles(profiles))
    named = tuple(own.spec.profile or (COMMON,))
    under = merged.of(named)
    used = [] if service.meta else [Level("profile", profiles[origin.name]) for origin, _ in reversed(under.layers)]
    policy = [Level("policy", s) for s in sources if s.kind == "Policy"]
    values = list(_spec([Level("manifest", own), *used], policy, service))
    if not service.meta:
        values += _container(service, own, under, used)
    return values


# -- what is beside the container ------------------------------------------------------------------------------


def _spec(levels: list[Level], policy: list[Level], service: Service) -> Iterator[Value]:
    own = levels[0]
    for name, told in fields_of(ServiceSpec).items():
        if name in ("ready", "live", "interlock"):
            guarded = [own, *(policy if service.protected or service.driver else [])]
            yield from _probe(guarded if name == "interlock" else levels, name, service)
        elif name == "update":
            for key, part in fields_of(told.model or BaseModel).items() if not service.meta else ():
                own_word = getattr(own.source.spec.update, key, None) is not None
                at = ("update" if own_word else "updates", key)
                yield from _first([own] if own_word else policy, at, part, service, ("update", key))
        elif name in ("idle", "resources"):
            for key, part in fields_of(told.model or BaseModel).items():
                yield from _first(_said_by(name, levels, policy), (name, key), part, service)
        elif name == "profile" and own.source.spec.profile and len(own.source.spec.profile) == 1:
            yield own.value(name, told, own.source.spec.profile[0], "spec", name)
        elif name == "needs":
            yield from _needs(levels, told, service)
        elif name == "ros":
            yield from _ros(own, told)
        elif name != "container":
            yield from _first(levels if name == "restart" else [own], (name,), told, service)


def _said_by(name: str, levels: list[Level], policy: list[Level]) -> list[Level]:
    """The manifests that may set the parts of `idle` or `resources`."""
    return levels[:1] if name == "resources" else [*levels, *policy]


def _ros(own: Level, told: FieldText) -> Iterator[Value]:
    """Each parameter as written; the values of those with secret names are not shown."""
    ros: Ros | None = own.source.spec.ros
    for name, value in ros.parameters.items() if ros else ():
        said = own.value(f"ros.parameters.{name}", told, value, "spec", "ros", "parameters", name)
        hidden = any(secret_texts(name.rpartition("/")[2], value))
        yield replace(said, value=None, text=NOT_SHOWN) if hidden else said


def _first(
    levels: list[Level], path: tuple[str, ...], told: FieldText, service: Service, field: tuple[str, ...] = ()
) -> Iterator[Value]:
    """The value of the first level that sets it, else the default if there is one. `field` is the path in a Service, if
    it differs from the path in manifests."""
    field = field or path
    for level in levels:
        value, at = level.source.spec, ("spec", *path)
        for key in path:
            value = getattr(value, key, None)
        if value is not None and at in level.source.document.values:
            yield level.value(".".join(field), told, value, *at)
            return
    value = _rendered(service, field)
    if value not in (None, (), {}) and (field[-1], value) not in UNSAID:
        yield Value(".".join(field), value, written(value, told.form), "default")


def _rendered(service: Service, path: tuple[str, ...]) -> Any:
    """The rendered value of a field that no manifest sets."""
    if path == ("type",):
        return "meta" if service.meta else "container"
    if path == ("profile",):
        return None if service.meta else COMMON
    if path in (("driver",), ("mounts",)):
        return None
    value: Any = service
    for key in path[path[0] == "resources" :]:
        value = getattr(value, key, None)
    return value


def _probe(levels: list[Level], name: str, service: Service) -> Iterator[Value]:
    """A probe comes as a whole from the first level that sets it."""
    for level in levels:
        probe: Any = getattr(level.source.spec, name, None)
        if isinstance(probe, BaseModel):
            for key, part in fields_of(type(probe)).items():
                if key == "interval" and getattr(probe, "all", None) and getattr(probe, key) is None:
                    continue  # each part has its own
                yield from _first([level], (name, key), part, service)
            return


def _needs(levels: list[Level], told: FieldText, service: Service) -> Iterator[Value]:
    count, implied = 0, dict(service.joins)
    once = {id(level.source): level for level in (levels[0], *reversed(levels[1:]))}
    for level in once.values():
        for index, need in enumerate(getattr(level.source.spec, "needs", ())):
            plain = need.service if not need.restart else {"service": need.service, "restart": True}
            if need.service != levels[0].source.name or level is levels[0]:
                yield level.value(f"needs[{count}]", told, plain, "spec", "needs", index)
                count += 1
                implied.pop(need.service, None)
    for name, options in implied.items():
        level = next(one for one in levels if getattr(one.source.spec.container, options[0], None) is not None)
        plain = {"service": name, "restart": True} if name in service.restarts_with else name
        yield level.value(f"needs[{count}]", told, plain, "spec", "container", options[0])
        count += 1


# -- the container ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Layer:
    """Options that one level declares for the container, as rendered. `at` is their place in the manifest, if they are
    written there one by one."""

    level: Level
    options: Mapping[str, Any]
    at: tuple[str | int, ...]

    def where(self, *path: str | int) -> tuple[str | int, ...]:
        return (*self.at, *path) if self.at == AT else self.at

    def says(self, path: tuple[str, ...]) -> bool:
        value: Any = self.options
        for key in path:
            if not isinstance(value, Mapping) or key not in value:
                return False
            value = value[key]
        return True


def _container(service: Service, own: Source, profile: Merged, used: list[Level]) -> Iterator[Value]:
    layers = _layers(own, profile, used)
    for option, value in sorted(service.options.items()):
        if option in ("image", "command"):
            continue
        if option == "environment":
            yield from _environment(value, layers, own, service.secrets)
        elif isinstance(value, list) and option != "entrypoint":
            for index, item in enumerate(value):
                yield _item(layers, option, index, item)
        else:
            yield from _leaves(layers, (option,), value)


def _layers(own: Source, profile: Merged, used: list[Level]) -> list[Layer]:
    """The layers in order of precedence."""
    manifest, layers = Level("manifest", own), []
    for options, part in collected(parts(own, profile))[0]:
        if part == "this manifest":
            spec: Any = own.spec
            count = len(declared(spec.container).get("volumes", ()))
            mounts = options.get("volumes", [])[count:]
            for index, mount in enumerate(mounts):
                layers.append(Layer(manifest, {"volumes": [mount]}, ("spec", "mounts", index)))
            layers.append(Layer(manifest, declared(spec.container), AT))
        else:
            asked = next((n for n in CALLS if getattr(own.spec, n)), part) if part in CALLS else part
            layers.append(Layer(manifest, options, ("spec", asked)))
    values = values_of(own)
    return [*reversed(layers), *(Layer(p, substitute(declared(p.source.spec.container), values), AT) for p in used)]


def _leaves(layers: list[Layer], path: tuple[str, ...], value: Any) -> Iterator[Value]:
    """Yields the values below a path. Mappings are merged key by key, so each key has its own source; a healthcheck is
    replaced as a whole."""
    if isinstance(value, dict) and value and path != ("healthcheck",):
        for key in value:
            yield from _leaves(layers, (*path, key), value[key])
        return
    field = ".".join(("container", *path))
    layer = next((x for x in layers if x.says(path)), None)
    if layer:
        yield layer.level.value(field, fields_of(ContainerOptions)[path[0]], value, *layer.where(*path))
    else:
        yield Value(field, value, inline(value), "default")


def _item(layers: list[Layer], option: str, index: int, item: Any) -> Value:
    field = f"container.{option}[{index}]"
    for layer in layers:
        directory = layers[0].level.source.directory
        for at, said in enumerate(layer.options.get(option, ())):
            same = (absolute(said, directory) if option == "volumes" else said) == item
            # The content of a seccomp file is sent; people want to see its name.
            if same or (str(item).startswith("seccomp={") and seccomp_file(str(said))):
                return layer.level.value(
                    field, fields_of(ContainerOptions)[option], item if same else said, *layer.where(option, at)
                )
    return Value(field, item, inline(item), "default")


def _environment(
    names: Mapping[str, Any], layers: list[Layer], own: Source, secrets: Collection[str]
) -> Iterator[Value]:
    """Values as manifests declare them. For secrets and variables from files, only names are shown."""
    for name in sorted(names):
        field = f"container.environment.{name}"
        layer = next((x for x in layers if name in x.options.get("environment", {})), None)
        if layer:
            value = layer.options["environment"][name]
            said = layer.level.value(
                field, fields_of(ContainerOptions)["environment"], value, *layer.where("environment", name)
            )
            yield replace(said, value=None, text=NOT_SHOWN) if name in secrets else said
        else:
            yield _of_a_file(field, name, layers, own)


def _of_a_file(field: str, name: str, layers: list[Layer], own: Source) -> Value:
    """The file that sets a variable. Later files win; those of profiles come first."""
    for layer in layers:
        files = list(enumerate(read_env_files(layer.options.get("env_file"))))
        for index, file in reversed(files):
            with suppress(OSError):
                if name in collected(variables_of(own, file))[0]:
                    where = layer.level.source.where(*layer.where("env_file", index))
                    return Value(field, None, NOT_SHOWN, "env_file", file.path, where)
    return Value(field, None, NOT_SHOWN, "env_file")
