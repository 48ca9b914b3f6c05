"""What a dev container consists of: the service's image and options, with the workspace and the identity of the person
who develops (the paper's Section III). Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from rorg.core.digest import digest
from rorg.model.catalog import Spec
from rorg.model.dev import (
    LABEL_DEV,
    LABEL_IMAGE,
    LABEL_OF,
    LABEL_SPEC,
    LABEL_USER,
    LABEL_WITH,
    LABEL_WORKSPACE,
    DevContainer,
)
from rorg.model.volumes import mounted_at

HOME = "/home/rorg-dev"
"""Place of the persistent home in the container: a path that neither images nor workspaces have."""
STAY = (
    "/bin/sh",
    "-c",
    "trap 'exit 0' TERM; while sleep 86400 2>/dev/null & wait $!; do :; done; while read -r _; do :; done",
)
"""Runs until SIGTERM. An image without `sleep` has a shell that reads from its standard input, which the engine keeps
open without ever writing to it."""
OF_ONE = frozenset(
    ("container_name", "ports", "publish_all_ports", "mac_address", "restart", "labels", "stop_grace_period", "tty")
)
"""Options that only one container can have, or that concern the service instead of its environment."""
OF_ONE_ON_A_NETWORK = frozenset(("aliases", "ipv4_address", "ipv6_address", "link_local_ips", "mac_address"))
GPUS = [{"count": "all", "capabilities": ["gpu"]}]
SCREEN = "/tmp/.X11-unix"
XAUTHORITY = "/tmp/.rorg-xauthority"
COVERED = frozenset(
    ("/", "/bin", "/boot", "/dev", "/etc", "/lib", "/lib32", "/lib64", "/proc", "/run", "/sbin", "/sys", "/usr", "/var")
)
"""Places of the image's own programs and of the kernel. A workspace mounted there would hide them."""
BASHRC = """# Made by `rorg dev`, and yours to edit: rorg leaves it as it is, also with --fresh.
PS1='($RORG_DEV) \\w\\$ '
shopt -s histappend
PROMPT_COMMAND='history -a'
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Developer:
    """The person who develops, and what they bring along."""

    user: str
    """UID:GID."""
    name: str
    workspace: str
    """Absolute path, the same inside and outside."""
    home: str
    """The persistent home on this machine."""
    git: Mapping[str, str]
    """Variables that tell git who the person is."""
    display: Mapping[str, str] | None = None
    """DISPLAY and, if they exist, the paths of XAUTHORITY and SOCKETS; None without X11."""
    gpu: bool = False

    @property
    def extras(self) -> tuple[str, ...]:
        """Everything requested in addition to the service's own options."""
        return (*(("x11",) if self.display is not None else ()), *(("gpu",) if self.gpu else ()))


def name_for(of: str) -> str:
    """The name of the dev container of a service, or of image/NAME."""
    return re.sub(r"[^a-zA-Z0-9_.-]+", "-", of.removeprefix("image/")).lstrip("_.-") + "-dev"


def plain_spec(image: str) -> Spec:
    """The options for an image without a service: the host's network, as for every service."""
    return {"image": image, "network_mode": "host"}


def dev_spec(spec: Spec, name: str, who: Developer) -> dict[str, Any]:
    """The dev container of a service, from the service's rendered options."""
    mounts = _mounts(who)
    taken = {mounted_at(m) for m in mounts}
    options = {option: value for option, value in spec.items() if option not in OF_ONE}
    if "networks" in options:
        options["networks"] = {
            network: {k: v for k, v in said.items() if k not in OF_ONE_ON_A_NETWORK}
            for network, said in options["networks"].items()
        }
    if who.gpu:
        options.setdefault("gpus", GPUS)
    return {
        **options,
        "entrypoint": list(STAY),
        "command": [],
        "healthcheck": {"disable": True},
        "init": True,
        "stdin_open": True,
        "stop_signal": "SIGTERM",
        "user": who.user,
        "working_dir": who.workspace,
        "volumes": [*(v for v in spec.get("volumes", ()) if mounted_at(v) not in taken), *mounts],
        "environment": {**spec.get("environment", {}), **_environment(name, who)},
    }


def _mounts(who: Developer) -> list[dict[str, Any]]:
    mounts = [(who.workspace, who.workspace, False), (who.home, HOME, False)]
    if who.display is not None:
        places = {"SOCKETS": SCREEN, "XAUTHORITY": XAUTHORITY}
        mounts += [(who.display[what], place, True) for what, place in places.items() if what in who.display]
    return [{"type": "bind", "source": s, "target": t, "read_only": only} for s, t, only in mounts]


def _environment(name: str, who: Developer) -> dict[str, str]:
    """Variables that shells and programs need, because the image may not know the user."""
    shell = {"PS1": f"({name}) $PWD \\$ ", "HISTFILE": f"{HOME}/.history", "RORG_DEV": name}
    variables = {"HOME": HOME, "USER": who.name, "LOGNAME": who.name, **shell, **who.git}
    if who.display is not None:
        variables |= {"DISPLAY": who.display["DISPLAY"]}
        variables |= {"XAUTHORITY": XAUTHORITY} if "XAUTHORITY" in who.display else {}
    return variables


def declared_digest(spec: Spec) -> str:
    """Identity of the options, without the image, which has an identity of its own."""
    return digest({option: value for option, value in spec.items() if option != "image"})


def dev_labels(instance: str, of: str, spec: Spec, image: str, who: Developer) -> dict[str, str]:
    """Labels of a dev container. `spec`: the rendered options; `image`: the id of its image."""
    return {
        LABEL_DEV: instance,
        LABEL_OF: of,
        LABEL_SPEC: declared_digest(spec),
        LABEL_IMAGE: image,
        LABEL_WORKSPACE: who.workspace,
        LABEL_USER: who.user,
        LABEL_WITH: ",".join(who.extras),
    }


def drift(container: DevContainer, spec: Spec, image: str, workspace: str, extras: Sequence[str]) -> list[str]:
    """How a new dev container would differ from the existing one. `image`: the current id of the spec's image."""
    why = []
    if image != container.image:
        why.append(f"{spec['image']} has changed since" if image else f"image {spec['image']} is not on this machine")
    if declared_digest(spec) != container.digest:
        why.append("the manifests have changed since")
    if not within(workspace, container.workspace):
        why.append(f"its workspace is {container.workspace}")
    missing = [extra for extra in extras if extra not in container.extras]
    return [*why, *([f"it was made without {' and '.join(missing)}"] if missing else [])]


def within(path: str, folder: str) -> bool:
    """Whether a directory is `folder`, or below it."""
    return PurePosixPath(path).is_relative_to(folder)
