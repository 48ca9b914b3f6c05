"""The kinds Network and Volume as pydantic models, under Compose's names."""

from __future__ import annotations

import ipaddress
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator

from rorg.manifest import option_checks as check
from rorg.manifest.fields import Written, field
from rorg.manifest.option_forms import Labels, Pairs, Strict
from rorg.model.volumes import VOLUME_NAME

NETWORK_NAME = rf"^{check.NETWORK}$"
DRIVER = r"^[a-zA-Z0-9][a-zA-Z0-9_.:/-]*$"


def _subnet(value: str) -> str:
    try:
        ipaddress.ip_network(value)
    except ValueError as error:
        raise ValueError(f"'{value}' is not a subnet ({error}); write 172.28.0.0/16") from None
    return value


Subnet = Annotated[str, AfterValidator(_subnet), Written("subnet")]
Address = Annotated[str, check.IP]
Driver = Annotated[str, Field(pattern=DRIVER)]


class Pool(Strict):
    """One range of addresses of a network."""

    subnet: Subnet | None = field("The addresses of the network.", "172.28.0.0/16", unset="what the engine gives")
    gateway: Address | None = field("The address of the host in it.", "172.28.0.1", unset="the first one")
    ip_range: Subnet | None = field(
        "Containers get addresses from this part of the subnet.", "172.28.5.0/24", unset="the whole subnet"
    )
    aux_addresses: Annotated[dict[str, Address], Written("mapping of addresses")] | None = field(
        "Reserved addresses, by names of your own.", {"camera": "172.28.0.10"}
    )

    @model_validator(mode="after")
    def _inside(self) -> Pool:
        if self.subnet is None:
            if self.gateway or self.ip_range or self.aux_addresses:
                raise ValueError("gateway, ip_range and aux_addresses need a subnet; write it")
            return self
        subnet = ipaddress.ip_network(self.subnet)
        for address in filter(None, [self.gateway, *(self.aux_addresses or {}).values()]):
            if ipaddress.ip_address(address) not in subnet:
                raise ValueError(f"{address} is not in {self.subnet}")
        if self.ip_range:
            part: Any = ipaddress.ip_network(self.ip_range)
            if part.version != subnet.version or not part.subnet_of(subnet):
                raise ValueError(f"{self.ip_range} is not in {self.subnet}")
        return self


class Ipam(Strict):
    """The assignment of addresses."""

    driver: Driver | None = field("The IPAM driver.", "default", unset="default")
    config: list[Pool] | None = field("Ranges of addresses.", [{"subnet": "172.28.0.0/16"}])
    options: Pairs | None = field("Options of the IPAM driver.", {"com.example.pool": "robots"})


def _alone(value: Strict) -> None:
    """An external object has no other options: its owner decides them."""
    said = sorted(value.model_fields_set - {"name", "external"})
    if said and getattr(value, "external", False):
        raise ValueError(f"{', '.join(said)} and external exclude each other: its owner decides its options")


class NetworkSpec(Strict):
    """A network of the engine: created together with the first container that joins it, and removed with the robot."""

    name: Annotated[str, Field(pattern=NETWORK_NAME)] | None = field(
        "What the engine calls it.", "fetch_ros", unset="the name in metadata"
    )
    driver: Driver | None = field("Its driver: bridge, macvlan ...", "bridge", unset="bridge")
    driver_opts: Pairs | None = field("Options of the driver.", {"com.docker.network.bridge.name": "ros0"})
    internal: bool | None = field("Isolates it from the outside.", True, unset="false")
    attachable: bool | None = field("Standalone containers may join it too, with Swarm.", True, unset="false")
    enable_ipv6: bool | None = field("It has IPv6 addresses.", True, unset="what the engine is set to")
    ipam: Ipam | None = field("Its addresses.", {"config": [{"subnet": "172.28.0.0/16"}]})
    labels: Labels | None = field("Labels of the network.", {"org.example.team": "arms"})
    external: bool = field("rorg neither creates nor removes it, and only joins it.", True, False)

    @model_validator(mode="after")
    def _external_alone(self) -> NetworkSpec:
        _alone(self)
        if self.name in ("host", "none", "bridge", "default") and not self.external:
            raise ValueError(f"'{self.name}' is the engine's own; write network_mode: {self.name} in the service")
        return self


class VolumeSpec(Strict):
    """A volume of the engine: created together with the first container that mounts it, and kept until
    `rorg down --volumes`, because it holds data."""

    name: Annotated[str, Field(pattern=f"^{VOLUME_NAME}$")] | None = field(
        "What the engine calls it.", "fetch_maps", unset="the name in metadata"
    )
    driver: Driver | None = field("Its driver.", "local", unset="local")
    driver_opts: Pairs | None = field(
        "Options of the driver.", {"type": "nfs", "o": "addr=10.0.0.2,rw", "device": ":/maps"}
    )
    labels: Labels | None = field("Labels of the volume.", {"org.example.team": "arms"})
    external: bool = field("rorg neither creates nor removes it, and only mounts it.", True, False)

    @model_validator(mode="after")
    def _external_alone(self) -> VolumeSpec:
        _alone(self)
        return self
