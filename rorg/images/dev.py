"""What a container to develop in is made of: the very image, and what the manifests say of the service, with the
workspace and the identity of whoever develops (the paper's Section III). Pure."""

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
"""Where the kept home is inside: a path that neither images nor workspaces have."""
STAY = (
    "/bin/sh",
    "-c",
    "trap 'exit 0' TERM; while sleep 86400 2>/dev/null & wait $!; do :; done; while read -r _; do :; done",
)
"""Stays until SIGTERM. An image without `sleep` has a shell that reads what nobody writes: its standard input is kept
open by the engine."""
OF_ONE = frozenset(
    ("container_name", "ports", "publish_all_ports", "mac_address", "restart", "labels", "stop_grace_period", "tty")
)
"""What only one container may have, or what is said of the service and not of its surroundings."""
OF_ONE_ON_A_NETWORK = frozenset(("aliases", "ipv4_address", "ipv6_address", "link_local_ips", "mac_address"))
GPUS = [{"count": "all", "capabilities": ["gpu"]}]
SCREEN = "/tmp/.X11-unix"
XAUTHORITY = "/tmp/.rorg-xauthority"
COVERED = frozenset(
    ("/", "/bin", "/boot", "/dev", "/etc", "/lib", "/lib32", "/lib64", "/proc", "/run", "/sbin", "/sys", "/usr", "/var")
)
"""Places of the image's own programs and of the kernel: a workspace there would hide them."""
BASHRC = """# Made by `rorg dev`, and yours: it stays as you leave it, also with --fresh.
PS1='($RORG_DEV) \\w\\$ '
shopt -s histappend
PROMPT_COMMAND='history -a'
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Developer:
    """Who develops, and what of theirs comes along."""

    user: str
    """UID:GID."""
    name: str
    workspace: str
    """Absolute; the same inside."""
    home: str
    """On this machine."""
    git: Mapping[str, str]
    """Variables of git that name the person."""
    display: Mapping[str, str] | None = None
    """DISPLAY, and where there are such the paths of XAUTHORITY and SOCKETS; None without X11."""
    gpu: bool = False

    @property
    def extras(self) -> tuple[str, ...]:
        """What was asked for beyond the service's own."""
        return (*(("x11",) if self.display is not None else ()), *(("gpu",) if self.gpu else ()))


def name_for(of: str) -> str:
    """What the container of a service, or of image/NAME, is called."""
    return re.sub(r"[^a-zA-Z0-9_.-]+", "-", of.removeprefix("image/")).lstrip("_.-") + "-dev"


def plain_spec(image: str) -> Spec:
    """Of an image that stands for itself: the host's network, as every service has it."""
    return {"image": image, "network_mode": "host"}


def dev_spec(spec: Spec, name: str, who: Developer) -> dict[str, Any]:
    """The container to develop in, from that of the service as rendered."""
    mounts = _mounts(who)
    taken = {mounted_at(m) for m in mounts}
    found = {option: value for option, value in spec.items() if option not in OF_ONE}
    if "networks" in found:
        found["networks"] = {
            network: {k: v for k, v in said.items() if k not in OF_ONE_ON_A_NETWORK}
            for network, said in found["networks"].items()
        }
    if who.gpu:
        found.setdefault("gpus", GPUS)
    return {
        **found,
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
    found = [(who.workspace, who.workspace, False), (who.home, HOME, False)]
    if who.display is not None:
        places = {"SOCKETS": SCREEN, "XAUTHORITY": XAUTHORITY}
        found += [(who.display[what], place, True) for what, place in places.items() if what in who.display]
    return [{"type": "bind", "source": s, "target": t, "read_only": only} for s, t, only in found]


def _environment(name: str, who: Developer) -> dict[str, str]:
    """The image may not know the user: what shells and programs look up is said here."""
    shell = {"PS1": f"({name}) $PWD \\$ ", "HISTFILE": f"{HOME}/.history", "RORG_DEV": name}
    found = {"HOME": HOME, "USER": who.name, "LOGNAME": who.name, **shell, **who.git}
    if who.display is not None:
        found |= {"DISPLAY": who.display["DISPLAY"]}
        found |= {"XAUTHORITY": XAUTHORITY} if "XAUTHORITY" in who.display else {}
    return found


def declared_digest(spec: Spec) -> str:
    """Identity of what the manifests say, without the image, which has one of its own."""
    return digest({option: value for option, value in spec.items() if option != "image"})


def dev_labels(instance: str, of: str, spec: Spec, image: str, who: Developer) -> dict[str, str]:
    """`spec` as rendered; `image`: the id of its image."""
    return {
        LABEL_DEV: instance,
        LABEL_OF: of,
        LABEL_SPEC: declared_digest(spec),
        LABEL_IMAGE: image,
        LABEL_WORKSPACE: who.workspace,
        LABEL_USER: who.user,
        LABEL_WITH: ",".join(who.extras),
    }


def drift(found: DevContainer, spec: Spec, image: str, workspace: str, extras: Sequence[str]) -> list[str]:
    """What one that was made anew would have otherwise. `image`: the id that the image of the spec has."""
    why = []
    if image != found.image:
        why.append(f"{spec['image']} is another image than its own" if image else f"no image {spec['image']} is here")
    if declared_digest(spec) != found.digest:
        why.append("the manifests say otherwise than when it was made")
    if not within(workspace, found.workspace):
        why.append(f"its workspace is {found.workspace}")
    missing = [extra for extra in extras if extra not in found.extras]
    return [*why, *([f"it was made without {' and '.join(missing)}"] if missing else [])]


def within(path: str, folder: str) -> bool:
    """Whether a directory is another one, or below it."""
    return PurePosixPath(path).is_relative_to(folder)
