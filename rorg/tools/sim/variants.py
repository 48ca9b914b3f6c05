"""Variants of a robot: another tree, another Policy, or other idle settings for all services that are not always on;
what they cost in CPU, memory and waiting, and which of them are efficient."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple

from rorg.errors import Invalid
from rorg.manifest.files import read_text
from rorg.manifest.load import load, usable
from rorg.manifest.model_errors import validated
from rorg.manifest.policy import Idle
from rorg.manifest.render import idle_of
from rorg.manifest.yaml_documents import with_document
from rorg.manifest.yaml_source import as_scalar, read_yaml
from rorg.manifest.yaml_text import yaml_text
from rorg.model.catalog import Catalog, Service
from rorg.model.diagnostics import nearest
from rorg.tools.sim.results import Response, RunResult

SETTINGS = {"linger": "linger", "idle": "action", "min_active": "min_active"}
"""Setting -> the field of `idle`."""
MOST = 100
"""Largest number of variants in a sweep."""


@dataclass(frozen=True, slots=True)
class Variant:
    """A robot on which a trace is tried."""

    name: str
    catalog: Catalog
    settings: Mapping[str, str] = field(default_factory=dict)
    """The settings as written; empty for a tree or a Policy."""


@dataclass(frozen=True, slots=True)
class Tree:
    """The manifests that the variants are based on."""

    root: Path
    catalog: Catalog
    engine: str = ""
    robot: str = ""


def variant(text: str, tree: Tree) -> Variant:
    """The variant for `[NAME=]WHAT`: a directory of manifests, the file of a Policy, or settings such as
    `linger=20s,idle=pause`. Raises Invalid."""
    first, equals, rest = text.partition("=")
    name, what = (first, rest) if equals and first not in SETTINGS and not Path(text).exists() else (text, text)
    if Path(what).is_dir():
        return Variant(name, usable(Path(what), load(Path(what), engine=tree.engine, robot=tree.robot)))
    if Path(what).is_file():
        return Variant(name, _with_policy(Path(what), tree))
    if "=" not in what:
        remedy = nearest(what, SETTINGS) or f"a directory, a Policy, or settings: {', '.join(SETTINGS)}"
        raise Invalid(f"compare '{text}'", f"'{what}' is neither a file nor a setting with a value", remedy)
    settings = _split(what, text)
    return Variant(name, with_settings(tree.catalog, settings), settings)


def sweep(texts: Sequence[str], tree: Tree) -> list[Variant]:
    """All combinations of `SETTING=VALUE,VALUE...`; the last setting changes fastest. Raises Invalid."""
    values = dict[str, list[str]]()
    for text in texts:
        key, equals, rest = text.partition("=")
        if key not in SETTINGS or not equals or not all(rest.split(",")):
            why = f"it is not a list of values for one of {', '.join(SETTINGS)}"
            raise Invalid(f"sweep over '{text}'", why, f"{key if key in SETTINGS else 'linger'}=VALUE,VALUE")
        if key in values:
            raise Invalid(f"sweep over '{text}'", f"{key} appears twice", "all of its values in one list")
        values[key] = rest.split(",")
    combinations = [dict(zip(values, each, strict=True)) for each in itertools.product(*values.values())]
    if len(combinations) > MOST:
        raise Invalid("sweep", f"that would be {len(combinations)} variants", f"at most {MOST}")
    return [Variant(_name(settings), with_settings(tree.catalog, settings), settings) for settings in combinations]


def _name(settings: Mapping[str, str]) -> str:
    return ",".join(f"{key}={value}" for key, value in settings.items())


def _split(what: str, text: str) -> dict[str, str]:
    settings = dict[str, str]()
    for part in what.split(","):
        key, equals, value = part.partition("=")
        if key in settings:
            raise Invalid(f"compare '{text}'", f"{key} is set twice", "one of the two")
        if key not in SETTINGS or not equals:
            remedy = nearest(key, SETTINGS) or f"one of {', '.join(SETTINGS)}"
            raise Invalid(f"compare '{text}'", f"'{part}' is not a setting", remedy)
        settings[key] = value
    return settings


def with_settings(catalog: Catalog, settings: Mapping[str, str]) -> Catalog:
    """The robot with these settings for all services that are not always on. Raises Invalid."""
    declared = {SETTINGS[key]: as_scalar(value) for key, value in settings.items()}
    document, _ = read_yaml(yaml_text(declared), "")
    assert document is not None
    idle, wrong = validated(Idle, document, declared, ())
    if wrong:
        remedy = wrong[0].remedy or "`rorg explain service.spec.idle` for what there is"
        raise Invalid(f"set {_name(settings)}", "; ".join(d.message for d in wrong), remedy)
    changes: dict[str, Any] = idle.model_dump(exclude_none=True)

    def changed(service: Service) -> Service:
        if service.meta or service.always_on:
            return service
        return replace(service, idle=idle_of(changes, service.idle))

    return replace(catalog, services={name: changed(service) for name, service in catalog.services.items()})


def _with_policy(file: Path, tree: Tree) -> Catalog:
    """The tree with another Policy. Settings of services and profiles still take precedence."""
    try:
        text = file.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise Invalid(f"read {file}", str(error), "the file of a Policy") from error
    document, _ = read_yaml(text, str(file))
    if document is not None and (not isinstance(document.value, dict) or document.value.get("kind") != "Policy"):
        raise Invalid(f"compare '{file}'", "it is not a Policy", "a directory of manifests, or the file of a Policy")
    sources = load(tree.root, engine=tree.engine, robot=tree.robot).sources or {}
    edits: dict[Path, str | None] = {}
    for policy in sources.get("Policy", {}).values():
        edits[policy.path] = with_document(read_text(policy.path, tree.root), ("Policy", policy.name), None)
    path = tree.root / "policies" / f"{file.stem}.yaml"
    edits[path] = f"{edits[path]}\n---\n{text}" if edits.get(path) else text
    return usable(file, load(tree.root, edits, engine=tree.engine, robot=tree.robot))


class Cost(NamedTuple):
    """Means over a run."""

    cpu: float
    """Cores."""
    memory: float
    """Bytes."""
    waiting: float
    """Seconds until a request is ready."""


@dataclass(frozen=True, slots=True)
class Tried:
    """A variant and its results. Only requests that take time with at least one variant count. Requests for services
    that are always on would hide the differences."""

    variant: Variant
    result: RunResult
    waits: tuple[float, ...]
    """Seconds, in order, of requests that became ready."""
    unready: int
    """Requests that were released before they were ready."""
    efficient: bool = False
    """No other variant costs less of something and no more of anything (Pareto)."""

    @property
    def cost(self) -> Cost:
        return Cost(self.result.cpu, self.result.memory, fmean(self.waits) if self.waits else 0.0)

    def as_json(self) -> dict[str, Any]:
        times = sorted(self.waits) or [0.0]
        return {
            "run": self.variant.name,
            "settings": dict(self.variant.settings),
            "cpu": round(self.result.cpu, 4),
            "memory": round(self.result.memory),
            "peak_memory": self.result.peak_memory,
            "requests": len(self.waits) + self.unready,
            "response_mean": round(self.cost.waiting, 4),
            "response_median": round(median(times), 4),
            "response_p95": round(times[ceil(0.95 * len(times)) - 1], 4),
            "unready": self.unready,
            "violations": len(self.result.violations),
            "calls": sum((self.result.actions or {}).values()),
            "efficient": self.efficient,
            **({} if self.result.shortage is None else {"cpu_short": round(self.result.shortage.seconds, 4)}),
        }


def tried(variants: Sequence[Variant], results: Sequence[RunResult]) -> list[Tried]:
    """In the order of the variants. All results are of the same trace."""
    each = list(zip(*(result.responses for result in results), strict=True))
    counted = [index for index, responses in enumerate(each) if any(r.seconds != 0 for r in responses)]
    return _marked([_tried(v, r, [r.responses[i] for i in counted]) for v, r in zip(variants, results, strict=True)])


def _tried(variant: Variant, result: RunResult, responses: Sequence[Response]) -> Tried:
    waits = tuple(r.seconds for r in responses if r.seconds is not None)
    return Tried(variant, result, waits, len(responses) - len(waits))


def _marked(candidates: Sequence[Tried]) -> list[Tried]:
    costs = [one.cost for one in candidates]
    return [replace(one, efficient=not any(_beats(other, one.cost) for other in costs)) for one in candidates]


def _beats(one: Cost, other: Cost) -> bool:
    return one != other and all(mine <= its for mine, its in zip(one, other, strict=True))
