"""Reads files of a workload: a document of kind Workload, which describes how services use the machine in a
simulation."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from rorg.manifest.fields import SCALAR, Written, field
from rorg.manifest.one_document import OneDocument, read_document
from rorg.manifest.option_forms import Duration, Memory, Name, Strict
from rorg.manifest.yaml_text import yaml_text
from rorg.model.diagnostics import Diagnostic, Reading, unknown
from rorg.model.units import format_duration
from rorg.model.workload import Behaviour, Distribution, Workload

Cores = Annotated[float, Field(strict=False, ge=0), Written("number of cores")]
Size = Annotated[Memory, Field(ge=0)]


def _spread(value: object) -> object:
    if isinstance(value, dict):
        return value
    return {"values": value if isinstance(value, list) else [value]}


class _Spread(Strict):
    """A value; {mean, deviation} of a normal distribution, cut off at 0; or a list of values that were measured."""

    @property
    def distribution(self) -> Distribution:
        given: Any = self
        if given.values is not None:
            return Distribution(tuple(map(float, given.values)))
        return Distribution((float(given.mean),), float(given.deviation))


class CoresSpread(_Spread):
    """Cores: a number, a normal distribution, or a list of measured numbers."""

    mean: Cores = field("The mean.", 0.4, 0.0)
    deviation: Cores = field("The standard deviation.", 0.1, 0.0)
    values: Annotated[list[Cores], Field(min_length=1)] | None = field("Measured values.", [0.3, 0.5])


class SizeSpread(_Spread):
    """Memory: a size, a normal distribution, or a list of measured sizes."""

    mean: Size = field("The mean.", "180Mi", 0)
    deviation: Size = field("The standard deviation.", "10Mi", 0)
    values: Annotated[list[Size], Field(min_length=1)] | None = field("Measured values.", ["150Mi", "190Mi"])


class DurationSpread(_Spread):
    """A duration, a normal distribution, or a list of measured durations."""

    mean: Duration = field("The mean.", "2s", 0.0)
    deviation: Duration = field("The standard deviation.", "300ms", 0.0)
    values: Annotated[list[Duration], Field(min_length=1)] | None = field("Measured values.", ["1.8s", "2.3s"])


_FORMS = (SCALAR, {"type": "array", "items": SCALAR})
CoresForm = Annotated[CoresSpread, BeforeValidator(_spread), Written("number of cores | CoresSpread | list", *_FORMS)]
SizeForm = Annotated[SizeSpread, BeforeValidator(_spread), Written("size | SizeSpread | list", *_FORMS)]
DurationForm = Annotated[DurationSpread, BeforeValidator(_spread), Written("duration | DurationSpread | list", *_FORMS)]


class CpuUse(Strict):
    """Cores that a service uses. Paused it uses none."""

    active: CoresForm | None = field("While something wants it.", 0.4, unset="`resources.cpu` of its manifest")
    idle: CoresForm | None = field("While it runs and nothing wants it.", 0.1, unset="as active")
    start: CoresForm | None = field("From its start until it is ready.", 1, unset="as later")


class MemoryUse(Strict):
    """Memory that a service uses."""

    active: SizeForm | None = field("While something wants it.", "180Mi", unset="`resources.memory` of its manifest")
    idle: SizeForm | None = field("While it runs and nothing wants it.", "120Mi", unset="as active")
    paused: SizeForm | None = field("While it is paused.", "120Mi", unset="as idle")


class BehaviourSpec(Strict):
    """How a service uses the machine."""

    class_: Name | None = field("A class whose values apply if they are not set here.", "camera", alias="class")
    cpu: CpuUse | None = field("Cores.", {"active": 0.4, "idle": 0.1})
    memory: MemoryUse | None = field("Memory.", {"active": "180Mi"})
    start: DurationForm | None = field("From its start until it is ready.", "2s", unset="what `ready` says, or 100ms")
    resume: DurationForm | None = field("From its resume until it is ready.", "50ms", unset="100ms")
    stop: DurationForm | None = field("Time that its programs take to end.", "500ms", unset="0s")
    growth: Size | None = field("Growth of its memory per hour of running.", "5Mi", unset="0")
    crashes: Annotated[float, Field(strict=False, ge=0)] | None = field("Crashes per hour of running.", 0.1, unset="0")


class WorkloadSpec(Strict):
    """How all services of a robot use the machine."""

    calls: dict[Literal["create", "start", "pause", "resume", "stop", "remove"], DurationForm] = field(
        "Duration of engine calls.", {"start": "90ms", "pause": ["12ms", "15ms"]}, dict
    )
    probed: bool = field(
        "Times of start and resume last until a probe found the service ready, as `rorg fit` measures them. Otherwise "
        "they last until the program is up, which its next probe finds.",
        True,
        False,
    )
    classes: dict[Name, BehaviourSpec] = field(
        "Values that several services share.", {"camera": {"crashes": 0.1}}, dict
    )
    services: dict[Name, BehaviourSpec] = field(
        "Services by name; unknown names are ignored.", {"usb_cam": {"class": "camera"}}, dict
    )
    others: BehaviourSpec | None = field("All other services.", {"cpu": {"active": 0.1}})


def read_workload(path: Path) -> Workload:
    """Reads a workload. Raises Invalid with all mistakes, each with file:line:column."""
    return read_document(path, "Workload", WorkloadSpec, _workload)


def workload_text(workload: Workload) -> str:
    """Writes the measured values of a workload as YAML, so that read_workload reads them again."""
    services = {name: _behaviour_text(one) for name, one in workload.services.items()}
    spec = {
        "calls": {verb: _written(spread) for verb, spread in workload.calls.items()},
        **({"probed": True} if workload.probed else {}),
        "services": services,
    }
    return yaml_text({"apiVersion": "rorg/v1", "kind": "Workload", "metadata": {"name": workload.name}, "spec": spec})


def _behaviour_text(one: Behaviour) -> dict[str, Any]:
    use: dict[str, Any] = {"cpu": {"active": one.cpu.values[0]}} if one.cpu else {}
    use |= {"memory": {"active": f"{round(one.memory.values[0] / 1024)}Ki"}} if one.memory else {}
    times = {word: _written(spread) for word in ("start", "resume", "stop") if (spread := getattr(one, word))}
    return {**use, **times}


def _written(spread: Distribution) -> list[str]:
    return [format_duration(round(seconds, 4)) for seconds in spread.values]


def _workload(source: OneDocument[WorkloadSpec]) -> Reading[Workload]:
    spec = source.spec
    places = list[tuple[tuple[str, ...], BehaviourSpec]]()
    places += [(("services", name), one) for name, one in spec.services.items()]
    places += [(("classes", name), one) for name, one in spec.classes.items()]
    places += [(("others",), spec.others)] if spec.others else []
    for path, one in places:
        where = source.document.where(("spec", *path, "class"))
        if one.class_ is not None and path[0] == "classes":
            yield Diagnostic(where, "a class has no class of its own", "to say everything in one")
        elif one.class_ is not None and one.class_ not in spec.classes:
            yield unknown(where, "class", one.class_, spec.classes)
    services = {name: _behaviour(one, spec.classes) for name, one in spec.services.items()}
    others = _behaviour(spec.others or BehaviourSpec(), spec.classes)
    calls = {str(verb): one.distribution for verb, one in spec.calls.items()}
    return Workload(source.name, services, others, calls, spec.probed)


def _behaviour(spec: BehaviourSpec, classes: Mapping[str, BehaviourSpec]) -> Behaviour:
    shared = classes.get(spec.class_ or "", BehaviourSpec())

    def use(of: str, when: str) -> Distribution | None:
        candidates = (getattr(getattr(one, of), when, None) for one in (spec, shared))
        return next((one.distribution for one in candidates if one is not None), None)

    def said(name: str) -> Any:
        return next((v for one in (spec, shared) if (v := getattr(one, name)) is not None), None)

    def spread(name: str) -> Distribution | None:
        one = said(name)
        return one.distribution if one is not None else None

    return Behaviour(
        cpu=use("cpu", "active"),
        cpu_idle=use("cpu", "idle"),
        cpu_start=use("cpu", "start"),
        memory=use("memory", "active"),
        memory_idle=use("memory", "idle"),
        memory_paused=use("memory", "paused"),
        start=spread("start"),
        resume=spread("resume"),
        stop=spread("stop"),
        growth=(said("growth") or 0) / 3600.0,
        crashes=said("crashes") or 0.0,
    )
