"""Compose's long forms of ports, devices and files of variables (compose-spec, 05-services.md).

Each becomes the equivalent short line if there is one, so that both forms are the same configuration.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Tag

from rorg.manifest import option_checks as check
from rorg.manifest.fields import TEXT, Written, field
from rorg.manifest.option_forms import Strict, Text


class Port(Strict):
    """A port to publish, or a range of them."""

    target: Annotated[Text, check.TARGET] = field("The port of the container, or a range of them.", 80, ...)
    published: Annotated[Text, check.PUBLISHED] | None = field(
        "The port of the host, or a range of which one is free.", "8080", unset="any that is free"
    )
    host_ip: Annotated[str, check.IP] | None = field("The address of the host.", "127.0.0.1", unset="all addresses")
    protocol: Literal["tcp", "udp", "sctp"] = field("The transport protocol.", "udp", "tcp")
    mode: Literal["host", "ingress"] | None = field(
        "Has no effect without Swarm; accepted for compatibility with Compose.", "host"
    )
    name: str | None = field("A name for people.", "web")
    app_protocol: str | None = field("The application protocol, for people.", "http")

    @property
    def line(self) -> str:
        """ADDRESS:HOST:CONTAINER/PROTOCOL."""
        address = f"[{self.host_ip}]" if ":" in (self.host_ip or "") else self.host_ip
        outside = ":".join(part for part in (address, self.published or ("" if address else None)) if part is not None)
        return f"{outside}:{self.target}/{self.protocol}".removeprefix(":").removesuffix("/tcp")


class DeviceEntry(Strict):
    """A device of the host."""

    source: str = field("The device on the host.", "/dev/video0", ...)
    target: str | None = field("Its path in the container.", "/dev/camera", unset="the same")
    permissions: str | None = field("Allowed access: r to read, w to write, m to make the node.", "rw", unset="rwm")

    @property
    def line(self) -> str:
        """SOURCE:TARGET:PERMISSIONS."""
        target = self.target or (self.source if self.permissions else None)
        return ":".join(part for part in (self.source, target, self.permissions) if part is not None)


class EnvFile(Strict):
    """A file of variables."""

    path: Annotated[str, check.WORD] = field("The file, relative to the manifest.", "./robot.env", ...)
    required: bool = field("false: it may be missing.", False, True)
    format: Literal["raw"] | None = field(
        "raw: each line is NAME=VALUE, taken literally with its quotes.", "raw", unset="as Compose reads it"
    )


def read_env_files(value: object) -> list[EnvFile]:
    """Returns every entry of a checked `env_file`, a path or a mapping, as an EnvFile."""
    items: Any = value or ()
    return [EnvFile(path=i) if isinstance(i, str) else i if isinstance(i, EnvFile) else EnvFile(**i) for i in items]


def _line(value: Any) -> Any:
    return value.line if isinstance(value, Port | DeviceEntry) else value


def _file(value: Any) -> Any:
    plain = isinstance(value, EnvFile) and value.required and value.format is None
    return value.path if plain else value


def _one_or_many(value: object) -> object:
    return [value] if isinstance(value, str | dict) else value


_form = Discriminator(lambda value: "mapping" if isinstance(value, dict | Strict) else "line")
PortForm = Annotated[
    Annotated[Text, Tag("line")] | Annotated[Port, Tag("mapping")], _form, AfterValidator(_line), check.PORTS
]
Device = Annotated[
    Annotated[str, Tag("line")] | Annotated[DeviceEntry, Tag("mapping")], _form, AfterValidator(_line), check.DEVICE
]
EnvFiles = Annotated[
    list[
        Annotated[
            Annotated[str, check.WORD, Tag("line")] | Annotated[EnvFile, Tag("mapping")], _form, AfterValidator(_file)
        ]
    ],
    BeforeValidator(_one_or_many),
    Written("text | list of text and EnvFile", TEXT, {"type": "object"}),
]
