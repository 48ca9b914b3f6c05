"""The kinds of manifests as pydantic models."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from rorg.manifest.container import ContainerOptions
from rorg.manifest.fields import Written, field
from rorg.manifest.objects import NetworkSpec, VolumeSpec
from rorg.manifest.option_forms import Duration, ImageName, Many, Name, Pairs, Strict, Words
from rorg.manifest.policy import Idle, PolicySpec
from rorg.manifest.probes import Live, Ready
from rorg.manifest.service import Needs, Priority, Restart, ServiceSpec
from rorg.model.machines import LONGEST_LEASE, PORT, SHORTEST_LEASE

API_VERSION = "rorg/v1"
PLATFORM = r"^[a-z0-9]+/[a-z0-9_]+(/[a-z0-9]+)?$"
ADDRESS = r"^(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9]([A-Za-z0-9.-]*[A-Za-z0-9])?)(:[0-9]{1,5})?$"


class Metadata(Strict):
    """The name of a manifest, its description and its labels."""

    name: Name = field(
        "Its name, unique in its kind: 2 to 63 letters, digits, -, _ and dots. One letter is enough for a service with "
        "a container_name. Two names must not differ only by case.",
        "navigation",
        ...,
    )
    description: str | None = field("Its purpose.", "Drives the robot to a place on the map.")
    labels: Pairs = field("Keys and values of your own; `rorg get -l` selects by them.", {"team": "navigation"}, dict)


class ImageMetadata(Metadata):
    """The name of an image, which is also its tag."""

    name: ImageName = field(
        "A reference in small letters: any number of parts, and a tag that is not latest.", "lab/navigation:1.2", ...
    )


class GroupSpec(Strict):
    """A name for several services."""

    services: Annotated[list[Name], Field(min_length=1)] = field(
        "Its members: services, and other groups.", ["navigation", "camera"], ...
    )


class ImageSpec(Strict):
    """How `rorg build` makes an image: from a Dockerfile, or from a root file system that a command writes."""

    context: str | None = field("Directory of the build, relative to this file.", "../../images/navigation")
    dockerfile: str = field("The Dockerfile, in the context.", "Dockerfile.arm64", "Dockerfile")
    args: Pairs = field("Arguments of the build.", {"ROS_DISTRO": "noetic"}, dict)
    target: Annotated[str, Field(min_length=1)] | None = field(
        "The stage of the Dockerfile that is built.", "runtime", unset="the last one"
    )
    additional_contexts: Pairs = field(
        "What the Dockerfile uses by a name (FROM, COPY --from, RUN --mount): a directory relative to this file, "
        "docker-image://REFERENCE, service:NAME for the image of a service, or the name of an Image.",
        {"maps": "../../maps", "tools": "docker-image://debian:12"},
        dict,
    )
    cache_from: Many[str] = field(
        "Images on the machine whose layers the build may use. They do not change the image's identity.",
        ["lab/navigation:latest"],
        list,
    )
    platform: Annotated[str, Field(pattern=PLATFORM), Written("OS/ARCHITECTURE[/VARIANT]")] | None = field(
        "The platform of the image.", "linux/arm64", unset="the engine's own"
    )
    import_: Words | None = field(
        "A command that writes a root file system as a tar stream; run in this file's directory.",
        "python3 ../../images/base/rootfs.py",
        alias="import",
    )

    @model_validator(mode="after")
    def _one(self) -> ImageSpec:
        if (self.context is None) == (self.import_ is None):
            raise ValueError("exactly one of context, import must be given")
        if self.context is None and (self.target or self.platform):
            raise ValueError("target and platform say how a context is built, and nothing is built here")
        if self.context is None and (self.additional_contexts or self.cache_from):
            raise ValueError("additional_contexts and cache_from are of a build, and nothing is built here")
        return self


class MachineSpec(Strict):
    """One computer of the robot. Each runs its own rorg, with `rorg run --machine NAME --listen ...`. The machine `any`
    is a Docker Swarm: its rorg runs on any computer that reaches the Swarm's managers."""

    address: Annotated[str, Field(pattern=ADDRESS), Written("HOST[:PORT]")] = field(
        f"The address at which other machines reach its rorg (`--listen`); the port is {PORT} by default.",
        "nora-base.local",
        ...,
    )
    certificate: Annotated[str, Field(min_length=1, max_length=64)] | None = field(
        "The common name of its TLS certificate.", "nora-base", unset="machine-NAME"
    )
    lease: Annotated[Duration, Field(ge=SHORTEST_LEASE, le=LONGEST_LEASE)] = field(
        "How long requests of other machines count on this one after the link has failed: 10s to 30s.", "20s", 15.0
    )
    default: bool = field("Services that name no machine belong to this one.", True, False)


class ProfileSpec(Strict):
    """Options that several services share. `${service}`, `${resources.cpu}` and `${resources.memory}` are filled in."""

    extends: list[Name] = field("Profiles that this one extends; its own values win.", ["ros1"], list)
    common: bool = field("false: without the defaults of the profile common.", False, True)
    needs: Needs = field("Added to the needs of the services.", ["roscore"], list)
    idle: Idle | None = field("Default for services that declare none.", {"action": "pause", "linger": "20s"})
    ready: Ready | None = field("Default for services that declare none.", {"delay": "2s"})
    live: Live | None = field("Default for services that declare none.", {"tcp": 9090, "interval": "10s"})
    restart: Restart | None = field("Default for services that declare none.", "on-failure")
    without_hardware: bool = field(
        "Replaces each device of a driver by /dev/null and omits realtime limits: for laptops and tests.", True, False
    )
    container: ContainerOptions | None = field(
        "Options of the container: mappings are merged by key, lists appended, everything else is replaced by what the "
        "service says.",
        {"environment": {"ROS_MASTER_URI": "http://base:11311"}},
    )


class RequestSpec(Strict):
    """A standing request: it applies whenever its requester is active."""

    requester: Name = field("The service that requests them; `developer` is always active.", "behavioral", "developer")
    services: Annotated[list[Name], Field(min_length=1)] = field(
        "Services and groups that are requested.", ["navigation"], ...
    )
    reason: str | None = field("The reason, which lists of requests show.", "the robot guides visitors")
    priority: Priority | None = field("0 to 100.", 80, unset="that of the services")


class Manifest(Strict):
    """The envelope of every manifest."""

    apiVersion: Literal["rorg/v1"] = field("The version of this form of manifests.", "rorg/v1", ...)
    kind: str = field("Service, Group, Image, Network, Volume, Machine, Profile, Policy or Request.", "Service", ...)
    metadata: Metadata = field("Its name and labels.", {"name": "navigation"}, ...)
    spec: Any = field("What it declares, by its kind.", {"image": "fetch-navigation"}, ...)


class ImageManifest(Manifest):
    """The envelope of an Image."""

    metadata: ImageMetadata = field("Its name.", {"name": "lab/navigation:1.2"}, ...)


SPECS: dict[str, type[Strict]] = {
    "Service": ServiceSpec,
    "Group": GroupSpec,
    "Image": ImageSpec,
    "Network": NetworkSpec,
    "Volume": VolumeSpec,
    "Machine": MachineSpec,
    "Profile": ProfileSpec,
    "Policy": PolicySpec,
    "Request": RequestSpec,
}
ENVELOPES: dict[str, type[Manifest]] = {kind: Manifest for kind in SPECS} | {"Image": ImageManifest}
EXAMPLES: dict[str, dict[str, Any]] = {
    "Service": {
        "image": "fetch-navigation",
        "command": "roslaunch /root/navigation/fetch_nav.launch --wait",
        "needs": ["localization"],
        "idle": {"action": "pause", "linger": "20s"},
    },
    "Group": {"services": ["navigation", "camera"]},
    "Image": {"context": "../../images/navigation"},
    "Network": {"ipam": {"config": [{"subnet": "172.28.0.0/16"}]}},
    "Volume": {"name": "fetch_maps"},
    "Machine": {"address": "nora-base.local"},
    "Profile": {"extends": ["ros1"], "idle": {"action": "pause", "linger": "20s"}},
    "Policy": {"budget": {"cpu": 3.2, "memory": "6Gi"}, "pressure": {"high": 1.0, "low": 0.85}},
    "Request": {"services": ["navigation"], "reason": "the robot guides visitors"},
}
"""A short example spec of each kind."""
FOLDERS = {
    "services": "Service",
    "groups": "Group",
    "images": "Image",
    "networks": "Network",
    "volumes": "Volume",
    "machines": "Machine",
    "profiles": "Profile",
    "policies": "Policy",
    "requests": "Request",
}
