"""Options of the container section that are mappings with fields of their own."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from rorg.manifest import option_checks as check
from rorg.manifest.fields import TEXT, TEXTS, Written, field
from rorg.manifest.option_forms import MOST, Bytes, Duration, Pairs, Strict
from rorg.model.volumes import PROPAGATION, VOLUME_NAME, is_target


class Ulimit(Strict):
    """A limit of the kernel; -1 means no limit."""

    soft: Annotated[int, Field(ge=-1)] = field("The effective limit; programs may raise it up to `hard`.", 1024, ...)
    hard: Annotated[int, Field(ge=-1)] = field("The most that `soft` may be raised to.", 65536, ...)

    @model_validator(mode="after")
    def _order(self) -> Ulimit:
        if self.hard != -1 and (self.soft == -1 or self.soft > self.hard):
            raise ValueError("soft is above hard")
        return self


class Logging(Strict):
    """The destination of the output."""

    driver: str = field("The engine's logging driver.", "local", "json-file")
    options: Pairs = field("Options of the driver.", {"max-size": "10m", "max-file": "3"}, dict)


def _test(value: list[str]) -> list[str]:
    if value and (value[0] not in ("NONE", "CMD", "CMD-SHELL") or (value[0] != "NONE" and len(value) < 2)):
        raise ValueError("a list must begin with CMD, CMD-SHELL or NONE, and go on with the command")
    return value


Pause = Annotated[Duration, check.between((0, 0), (0.001, MOST), what="the engine takes 1ms and more")]


class Healthcheck(Strict):
    """The engine's own health check."""

    test: (
        Annotated[
            list[str],
            BeforeValidator(lambda v: ["CMD-SHELL", v] if isinstance(v, str) else v),
            AfterValidator(_test),
            Written("text | list of text", TEXT),
        ]
        | None
    ) = field(
        "The command: a line for the shell, or a list that begins with CMD, CMD-SHELL or NONE.",
        ["CMD", "curl", "-f", "http://localhost:8080/health"],
        unset="the image's",
    )
    interval: Pause | None = field("Time between two checks.", "10s", unset="30s")
    timeout: Pause | None = field("After this, a check counts as failed.", "3s", unset="30s")
    retries: Annotated[int, Field(ge=0)] | None = field("Failures in a row that make it unhealthy.", 5, unset="3")
    start_period: Pause | None = field("Time after the start in which failures do not count.", "20s", unset="0s")
    disable: bool = field("Turns off the image's check.", True, False)


class BindOptions(Strict):
    """Options of a mount from the host."""

    propagation: Literal[PROPAGATION] | None = field(  # type: ignore[valid-type]
        "Whether later mounts below it are visible on the other side.", "rslave", unset="rprivate"
    )
    create_host_path: bool | None = field("Creates the directory on the host if it is missing.", True, unset="false")
    selinux: Literal["z", "Z"] | None = field("SELinux label: z is shared with other containers, Z is not.", "z")


class VolumeOptions(Strict):
    """Options of a mount of a volume."""

    nocopy: bool | None = field("An empty volume is not filled with the image's files.", True, unset="false")


class TmpfsOptions(Strict):
    """Options of a tmpfs mount."""

    size: Bytes | None = field("Maximum size.", "64Mi", unset="half of the machine's memory")
    mode: Annotated[int, Field(ge=0, le=0o7777)] | None = field(
        "Permissions of the directory, as a number; 0o1777 lets everyone write.", 0o1777, unset="0o1777"
    )


class Mount(Strict):
    """Compose's long form of a volume."""

    type: Literal["bind", "volume", "tmpfs"] = field(
        "A path of the host, a volume of the engine, or memory.", "bind", ...
    )
    source: str | None = field(
        "The path on the host, or the name of the volume.", "./navigation", unset="a volume without a name"
    )
    target: str = field("The path in the container.", "/root/navigation", ...)
    read_only: bool = field("The container may only read it.", True, False)
    consistency: Literal["consistent", "cached", "delegated"] | None = field(
        "Has no effect on Linux; accepted for compatibility with Compose.", "cached"
    )
    bind: BindOptions | None = field("Options for type: bind.", {"propagation": "rslave"})
    volume: VolumeOptions | None = field("Options for type: volume.", {"nocopy": True})
    tmpfs: TmpfsOptions | None = field("Options for type: tmpfs.", {"size": "64Mi"})

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
    """A limit per second for one device."""

    path: DevicePath = field("The device.", "/dev/sda", ...)
    rate: Bytes = field("Bytes per second, or operations per second for *_iops.", "10Mi", ...)


Share = Annotated[int, check.between((0, 0), (10, 1000), what="write 10 to 1000")]


class Weight(Strict):
    """The share of one device."""

    path: DevicePath = field("The device.", "/dev/sda", ...)
    weight: Share = field("Its share, 10 to 1000.", 300, ...)


class BlkioConfig(Strict):
    """Limits and shares of block devices."""

    weight: Share | None = field("Share of all block devices, 10 to 1000.", 300, unset="500")
    weight_device: list[Weight] | None = field("Shares of single devices.", [{"path": "/dev/sda", "weight": 300}])
    device_read_bps: list[Rate] | None = field(
        "Maximum bytes read per second.", [{"path": "/dev/sda", "rate": "10Mi"}], unset="no limit"
    )
    device_write_bps: list[Rate] | None = field(
        "Maximum bytes written per second.", [{"path": "/dev/sda", "rate": "10Mi"}], unset="no limit"
    )
    device_read_iops: list[Rate] | None = field(
        "Maximum reads per second.", [{"path": "/dev/sda", "rate": 1000}], unset="no limit"
    )
    device_write_iops: list[Rate] | None = field(
        "Maximum writes per second.", [{"path": "/dev/sda", "rate": 1000}], unset="no limit"
    )


class Gpu(Strict):
    """One request for GPUs."""

    driver: str | None = field("The driver of the GPUs.", "nvidia", unset="what the engine finds")
    count: Annotated[int, Field(ge=-1)] | Literal["all"] | None = field(
        "How many; -1 or all for every GPU.", 1, unset="all"
    )
    device_ids: list[str] | None = field("Specific GPUs, instead of a count.", ["0"])
    capabilities: list[str] = field("Required capabilities.", ["gpu", "compute"], lambda: ["gpu"])
    options: Pairs | None = field("Options of the driver.", {"virtualization": "false"})

    @model_validator(mode="after")
    def _one(self) -> Gpu:
        if self.count is not None and self.device_ids:
            raise ValueError("count and device_ids exclude each other")
        return self


class Network(Strict):
    """The container's endpoint in one network."""

    aliases: list[Annotated[str, check.WORD]] | None = field("Additional names of the container in it.", ["base"])
    ipv4_address: Annotated[str, check.IPV4] | None = field(
        "Its IPv4 address.", "172.20.0.10", unset="what the engine gives"
    )
    ipv6_address: Annotated[str, check.IPV6] | None = field(
        "Its IPv6 address.", "2001:db8::10", unset="what the engine gives"
    )
    link_local_ips: list[Annotated[str, check.IP]] | None = field("Link-local addresses.", ["169.254.8.8"])
    mac_address: Annotated[str, check.MAC] | None = field(
        "Its MAC address.", "02:42:ac:11:00:02", unset="what the engine gives"
    )
    driver_opts: Pairs | None = field(
        "Options of the network's driver.", {"com.docker.network.endpoint.ifname": "lan0"}
    )


def read_networks(value: object) -> object:
    """Converts a list of names to a mapping."""
    if isinstance(value, list):
        if not all(isinstance(name, str) for name in value):
            raise ValueError("each item must be the name of a network")
        return {name: {} for name in value}
    if isinstance(value, str):
        raise ValueError(f"must be a list of names, or a mapping; try [{value}]")
    return {k: {} if v is None else v for k, v in value.items()} if isinstance(value, dict) else value


def _network_names(value: dict[str, Any]) -> dict[str, Any]:
    for name, network in value.items():
        if name.lower() in ("host", "none"):
            raise ValueError(f"'{name}' is not a network to join; write network_mode: {name.lower()}")
        check.require(check.NETWORK, name, "the name of a network")
        if name == "bridge" and network != Network():
            raise ValueError(f"'{name}' takes no options; write the name of a network of your own")
    return value


def read_ulimits(value: object) -> object:
    """Converts a single number to both limits."""
    if isinstance(value, dict):
        return {k: {"soft": v, "hard": v} if type(v) is int else v for k, v in value.items()}
    return value


def read_hosts(value: object) -> object:
    """Converts a mapping to lines NAME:ADDRESS."""
    return [f"{name}:{address}" for name, address in value.items()] if isinstance(value, dict) else value


def read_gpus(value: object) -> object:
    """Converts `all` to a request for every GPU."""
    return [{"count": "all"}] if value == "all" else value


Volume = Annotated[
    Annotated[str, check.VOLUME, Tag("line")] | Annotated[Mount, Tag("mapping")],
    Discriminator(lambda value: "line" if isinstance(value, str) else "mapping"),
]
Networks = Annotated[
    dict[str, Annotated[Network, Written("Network", {"type": "null"})]],
    BeforeValidator(read_networks),
    AfterValidator(_network_names),
    Written("list of names | mapping of Network", TEXTS),
]
Ulimits = Annotated[
    dict[str, Annotated[Ulimit, Written("number | Ulimit", {"type": "integer"})]],
    BeforeValidator(read_ulimits),
    check.LIMITS,
    Written("mapping of number | Ulimit"),
]
Hosts = Annotated[
    list[Annotated[str, check.EXTRA_HOST]],
    BeforeValidator(read_hosts),
    Written("list of NAME:ADDRESS | mapping of addresses", {"type": "object"}),
]
Gpus = Annotated[list[Gpu], BeforeValidator(read_gpus), Written("all | list of Gpu", {"const": "all"})]
