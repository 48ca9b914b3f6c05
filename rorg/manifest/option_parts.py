"""Options of the container section that are mappings, each with its own fields."""

from __future__ import annotations

import ipaddress
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from rorg.manifest import option_checks as check
from rorg.manifest.option_forms import MOST, Bytes, Pairs, Strict
from rorg.manifest.scalars import Duration
from rorg.model.volumes import PROPAGATION, VOLUME_NAME, is_target


class Ulimit(Strict):
    """A limit of the kernel; -1 is none."""

    soft: Annotated[int, Field(ge=-1)]
    hard: Annotated[int, Field(ge=-1)]

    @model_validator(mode="after")
    def _order(self) -> Ulimit:
        if self.hard != -1 and (self.soft == -1 or self.soft > self.hard):
            raise ValueError("soft is above hard")
        return self


class Logging(Strict):
    """Where the output goes."""

    driver: str = "json-file"
    options: Pairs = Field(default_factory=dict)


def _test(value: list[str]) -> list[str]:
    if value and (value[0] not in ("NONE", "CMD", "CMD-SHELL") or (value[0] != "NONE" and len(value) < 2)):
        raise ValueError("a list must begin with CMD, CMD-SHELL or NONE, and go on with the command")
    return value


Pause = Annotated[Duration, check.between((0, 0), (0.001, MOST), what="the engine takes 1ms and more")]


class Healthcheck(Strict):
    """The engine's own question to the container."""

    test: (
        Annotated[
            list[str], BeforeValidator(lambda v: ["CMD-SHELL", v] if isinstance(v, str) else v), AfterValidator(_test)
        ]
        | None
    ) = None
    interval: Pause | None = None
    timeout: Pause | None = None
    retries: Annotated[int, Field(ge=0)] | None = None
    start_period: Pause | None = None
    disable: bool = False


class BindOptions(Strict):
    """Of a mount from the host."""

    propagation: Literal[PROPAGATION] | None = None  # type: ignore[valid-type]
    create_host_path: bool | None = None
    selinux: Literal["z", "Z"] | None = None


class VolumeOptions(Strict):
    """Of a mount of a volume."""

    nocopy: bool | None = None


class TmpfsOptions(Strict):
    """Of a mount of memory."""

    size: Bytes | None = None
    mode: Annotated[int, Field(ge=0, le=0o7777)] | None = None


class Mount(Strict):
    """Compose's long form of a volume."""

    type: Literal["bind", "volume", "tmpfs"]
    source: str | None = None
    target: str
    read_only: bool = False
    consistency: Literal["consistent", "cached", "delegated"] | None = None
    bind: BindOptions | None = None
    volume: VolumeOptions | None = None
    tmpfs: TmpfsOptions | None = None

    @model_validator(mode="after")
    def _of_one_kind(self) -> Mount:
        other = next((k for k in ("bind", "volume", "tmpfs") if k != self.type and getattr(self, k) is not None), None)
        if other:
            raise ValueError(f"'{other}' means nothing for type: {self.type}")
        if not is_target(self.target) and "${" not in self.target:
            raise ValueError(f"target '{self.target}' must be a path in the container, and not /")
        self._check_source()
        return self

    def _check_source(self) -> None:
        if self.type == "tmpfs" and self.source:
            raise ValueError("type: tmpfs has no source")
        if self.type == "bind" and not self.source:
            raise ValueError("type: bind needs a source")
        if self.type == "volume" and self.source:
            check.require(VOLUME_NAME, self.source, "the name of a volume; write type: bind for a path")


DevicePath = Annotated[str, check.PATH]


class Rate(Strict):
    """Most of one device, a second."""

    path: DevicePath
    rate: Bytes


Share = Annotated[int, check.between((0, 0), (10, 1000), what="write 10 to 1000")]


class Weight(Strict):
    """Share of one device."""

    path: DevicePath
    weight: Share


class BlkioConfig(Strict):
    """Limits and shares of block devices."""

    weight: Share | None = None
    weight_device: list[Weight] | None = None
    device_read_bps: list[Rate] | None = None
    device_write_bps: list[Rate] | None = None
    device_read_iops: list[Rate] | None = None
    device_write_iops: list[Rate] | None = None


class Gpu(Strict):
    """One request for GPUs."""

    driver: str | None = None
    count: Annotated[int, Field(ge=-1)] | Literal["all"] | None = None
    device_ids: list[str] | None = None
    capabilities: list[str] = Field(default_factory=lambda: ["gpu"])
    options: Pairs | None = None

    @model_validator(mode="after")
    def _one(self) -> Gpu:
        if self.count is not None and self.device_ids:
            raise ValueError("count and device_ids exclude each other")
        return self


def _of_version(version: int) -> AfterValidator:
    def run(value: str) -> str:
        try:
            if ipaddress.ip_address(value).version == version:
                return value
        except ValueError:
            pass
        raise ValueError(f"'{value}' is not an IPv{version} address")

    return AfterValidator(run)


class Network(Strict):
    """How the container is joined to one network."""

    aliases: list[Annotated[str, check.WORD]] | None = None
    ipv4_address: Annotated[str, _of_version(4)] | None = None
    ipv6_address: Annotated[str, _of_version(6)] | None = None
    link_local_ips: list[Annotated[str, check.IP]] | None = None
    mac_address: Annotated[str, check.MAC] | None = None
    driver_opts: Pairs | None = None


def read_networks(value: object) -> object:
    """A list of names as a mapping."""
    if isinstance(value, list):
        if not all(isinstance(name, str) for name in value):
            raise ValueError("each item must be the name of a network")
        return {name: {} for name in value}
    return {k: {} if v is None else v for k, v in value.items()} if isinstance(value, dict) else value


def _network_names(value: dict[str, Any]) -> dict[str, Any]:
    for name, network in value.items():
        if name.lower() in ("host", "none"):
            raise ValueError(f"'{name}' is no network to join; write network_mode: {name.lower()}")
        check.require(check.NETWORK, name, "the name of a network")
        if name in ("bridge", "default") and network != Network():
            raise ValueError(f"'{name}' takes no options; write the name of a network of your own")
    return value


def read_ulimits(value: object) -> object:
    """One number for both limits."""
    if isinstance(value, dict):
        return {k: {"soft": v, "hard": v} if type(v) is int else v for k, v in value.items()}
    return value


def read_hosts(value: object) -> object:
    """A mapping as lines NAME:ADDRESS."""
    return [f"{name}:{address}" for name, address in value.items()] if isinstance(value, dict) else value


def read_gpus(value: object) -> object:
    """`all` as a request for every GPU."""
    return [{"count": "all"}] if value == "all" else value


Volume = Annotated[
    Annotated[str, check.VOLUME, Tag("line")] | Annotated[Mount, Tag("mapping")],
    Discriminator(lambda value: "line" if isinstance(value, str) else "mapping"),
]
Networks = Annotated[dict[str, Network], BeforeValidator(read_networks), AfterValidator(_network_names)]
Ulimits = Annotated[dict[str, Ulimit], BeforeValidator(read_ulimits), check.LIMITS]
Hosts = Annotated[list[Annotated[str, check.EXTRA_HOST]], BeforeValidator(read_hosts)]
Gpus = Annotated[list[Gpu], BeforeValidator(read_gpus)]
