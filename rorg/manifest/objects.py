"""Networks and volumes that a tree declares, under Compose's names."""

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
        "Addresses that no container gets, by names of your own.", {"camera": "172.28.0.10"}
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
    """Who gives addresses, and which."""

    driver: Driver | None = field("What gives addresses.", "default", unset="default")
    config: list[Pool] | None = field("Ranges of addresses.", [{"subnet": "172.28.0.0/16"}])
    options: Pairs | None = field("Options of what gives addresses.", {"com.example.pool": "robots"})


def _alone(value: Strict) -> None:
    """Somebody else says how an external one is."""
    said = sorted(value.model_fields_set - {"name", "external"})
    if said and getattr(value, "external", False):
        raise ValueError(f"{', '.join(said)} and external exclude each other: whoever makes it says how it is")


class NetworkSpec(Strict):
    """A network of the engine: made when a container that joins it is made, and removed with the robot."""

    name: Annotated[str, Field(pattern=NETWORK_NAME)] | None = field(
        "What the engine calls it.", "fetch_ros", unset="the name in metadata"
    )
    driver: Driver | None = field("What makes it: bridge, macvlan ...", "bridge", unset="bridge")
    driver_opts: Pairs | None = field("Options of the driver.", {"com.docker.network.bridge.name": "ros0"})
    internal: bool | None = field("Nothing outside can be reached from it.", True, unset="false")
    attachable: bool | None = field("Containers of nobody's may join it too, with Swarm.", True, unset="false")
    enable_ipv6: bool | None = field("It has IPv6 addresses.", True, unset="what the engine is set to")
    ipam: Ipam | None = field("Its addresses.", {"config": [{"subnet": "172.28.0.0/16"}]})
    labels: Labels | None = field("Labels of the network.", {"org.example.team": "arms"})
    external: bool = field("It is made and removed by somebody else; rorg only joins it.", True, False)

    @model_validator(mode="after")
    def _external_alone(self) -> NetworkSpec:
        _alone(self)
        if self.name in ("host", "none", "bridge", "default") and not self.external:
            raise ValueError(f"'{self.name}' is the engine's own; write network_mode: {self.name} in the service")
        return self


class VolumeSpec(Strict):
    """A volume of the engine: made when a container that mounts it is made, and kept, since it holds data, until
    `rorg down --volumes`."""

    name: Annotated[str, Field(pattern=f"^{VOLUME_NAME}$")] | None = field(
        "What the engine calls it.", "fetch_maps", unset="the name in metadata"
    )
    driver: Driver | None = field("What keeps the data.", "local", unset="local")
    driver_opts: Pairs | None = field(
        "Options of the driver.", {"type": "nfs", "o": "addr=10.0.0.2,rw", "device": ":/maps"}
    )
    labels: Labels | None = field("Labels of the volume.", {"org.example.team": "arms"})
    external: bool = field("It is made and removed by somebody else; rorg only mounts it.", True, False)

    @model_validator(mode="after")
    def _external_alone(self) -> VolumeSpec:
        _alone(self)
        return self
