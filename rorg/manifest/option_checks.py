"""Checks of the values of container options, as strict as the engine's: `create` and `start` accept what passes here.

A text in a Profile may contain `${service}`. Such text is checked again after it is filled in.
"""

from __future__ import annotations

import difflib
import ipaddress
import re
import signal
from collections.abc import Callable, Collection
from functools import partial
from typing import Any

from pydantic import AfterValidator, ValidationInfo

from rorg.model.ports import check_published, check_target, parse_expose, parse_ports
from rorg.model.volumes import parse_device, parse_tmpfs, parse_volume

FINAL = {"final": True}
PARTIAL = {"partial": True}
"""Context of a value whose mistakes are left out: keys may be missing."""
"""Validation context once every `${...}` is filled in."""


def checked(check: Callable[[str], Any]) -> AfterValidator:
    """A validator for text: fails if `check` raises ValueError."""

    def run(value: str, info: ValidationInfo) -> str:
        if not ("${" in value and info.context != FINAL):
            check(value)
        return value

    return AfterValidator(run)


def turned(turn: Callable[[str], str]) -> AfterValidator:
    """A validator that replaces text by what `turn` makes of it."""
    return AfterValidator(lambda value, info: value if "${" in value and info.context != FINAL else turn(value))


def require(pattern: str, value: str, what: str) -> None:
    """Raises ValueError unless the whole text matches."""
    if not re.fullmatch(pattern, value, re.ASCII):
        raise ValueError(f"'{value}' is not {what}")


def form(pattern: str, what: str) -> Callable[[str], None]:
    """A check of a text: the whole of it must match."""
    return lambda value: require(pattern, value, what)


def like(pattern: str, what: str) -> AfterValidator:
    """A validator for text: the whole of it must match."""
    return checked(form(pattern, what))


def between(*ranges: tuple[float, float], what: str) -> AfterValidator:
    """A validator for a number in one of these ranges, ends included; `what` says how to write it."""

    def check(value: Any) -> Any:
        if not any(low <= value <= high for low, high in ranges):
            raise ValueError(f"{value:g} is out of range; {what}")
        return value

    return AfterValidator(check)


_CAPABILITIES = """
ALL AUDIT_CONTROL AUDIT_READ AUDIT_WRITE BLOCK_SUSPEND BPF CHECKPOINT_RESTORE CHOWN DAC_OVERRIDE DAC_READ_SEARCH FOWNER
FSETID IPC_LOCK IPC_OWNER KILL LEASE LINUX_IMMUTABLE MAC_ADMIN MAC_OVERRIDE MKNOD NET_ADMIN NET_BIND_SERVICE
NET_BROADCAST NET_RAW PERFMON SETFCAP SETGID SETPCAP SETUID SYSLOG SYS_ADMIN SYS_BOOT SYS_CHROOT SYS_MODULE SYS_NICE
SYS_PACCT SYS_PTRACE SYS_RAWIO SYS_RESOURCE SYS_TIME SYS_TTY_CONFIG WAKE_ALARM"""
CAPABILITIES = frozenset(_CAPABILITIES.split())
_ULIMITS = """
core cpu data fsize locks memlock msgqueue nice nofile nproc rss rtprio rttime sigpending stack"""
ULIMITS = frozenset(_ULIMITS.split())
SIGNALS = frozenset(
    (*signal.Signals.__members__, *(f"SIGRTMIN+{n}" for n in range(1, 16)), *(f"SIGRTMAX-{n}" for n in range(1, 15)))
)
NUMBERS = frozenset(str(n) for n in range(1, 65) if n not in (32, 33))
"""Numbers of signals that the engine can send; libc reserves 32 and 33."""


def _near(name: str, known: Collection[str]) -> str:
    return "; try " + matches[0] if (matches := difflib.get_close_matches(name, sorted(known), 1)) else ""


def _capability(value: str) -> None:
    name = value.upper().removeprefix("CAP_")
    if name not in CAPABILITIES:
        raise ValueError(f"'{value}' is not a capability{_near(name, CAPABILITIES)}")


def check_ulimit(name: str) -> None:
    """Raises ValueError for a limit that Linux does not have."""
    if name not in ULIMITS:
        raise ValueError(f"'{name}' is not a limit{_near(name, ULIMITS)}")


def read_signal(value: object) -> str:
    """A signal's name, or its number as text."""
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise ValueError(f"'{value}' is not a signal; write SIGINT or SIGTERM")
    text = str(value).upper()
    if "${" in text:
        return str(value)
    name = text if text.startswith("SIG") or text.isdigit() else f"SIG{text}"
    if name not in SIGNALS | NUMBERS:
        raise ValueError(f"'{value}' is not a signal; write SIGINT or SIGTERM")
    return name


def _ip(value: str, version: int = 0) -> None:
    try:
        actual_version = int(ipaddress.ip_address(value).version)
    except ValueError:
        actual_version = -1
    if actual_version < 0 or version not in (0, actual_version):
        raise ValueError(f"'{value}' is not an IP{f'v{version}' if version else ''} address")


def _extra_host(value: str) -> str:
    """Returns NAME:ADDRESS; Compose also accepts NAME=ADDRESS and brackets around the address."""
    match = re.match(r"([^:=\s]+)[:=](\S+)$", value)
    if not match:
        raise ValueError(f"'{value}' is not a host; write NAME:ADDRESS")
    address = match[2][1:-1] if match[2].startswith("[") and match[2].endswith("]") else match[2]
    if address != "host-gateway":
        _ip(address)
    return f"{match[1]}:{address}"


def _cpus(value: str) -> None:
    """Such as 0-2,4."""
    for part in value.split(","):
        match = re.fullmatch(r"([0-9]{1,4})(?:-([0-9]{1,4}))?", part, re.ASCII)
        if not match or int(match[1]) > int(match[2] or match[1]):
            raise ValueError(f"'{value}' is not a list of numbers; write 0-2,4")


def _working_dir(value: str) -> None:
    if not (value.startswith(("/", "./", "../", "~/")) or value in (".", "..", "~")):
        raise ValueError(
            f"'{value}' is not an absolute path in the container; write ./{value} for one beside the manifest"
        )


def check_image(value: str) -> None:
    """Raises ValueError if this is not a reference of an image."""
    part = r"[a-z0-9]+(?:(?:\.|_|__|-+)[a-z0-9]+)*"
    domain = r"(?=localhost/|[^/]*[.:])(?:[a-zA-Z0-9](?:[a-zA-Z0-9.-]*[a-zA-Z0-9])?|\[[0-9a-fA-F:]+\])(?::[0-9]+)?"
    digest = r"[A-Za-z][A-Za-z0-9]*(?:[-_+.][A-Za-z][A-Za-z0-9]*)*:[0-9a-fA-F]{32,}"
    name = rf"(?:{domain}/)?{part}(?:/{part})*(?::\w[\w.-]{{0,127}})?(?:@{digest})?"
    if not re.fullmatch(rf"{name}|sha256:[0-9a-f]{{64}}", value, re.ASCII):
        raise ValueError(f"'{value}' is not an image reference; write name:tag in small letters")


def _network_mode(value: str) -> None:
    if value.lower() in ("host", "none", "bridge", "default") and value != value.lower():
        raise ValueError(f"'{value}' must be written {value.lower()}")
    if value and not re.fullmatch(r"(container:|service:)?[a-zA-Z0-9][a-zA-Z0-9_.-]*", value, re.ASCII):
        known = "host, bridge, none, a network's name, service:NAME or container:NAME"
        raise ValueError(f"'{value}' is not a network; write {known}")


def _namespace(*modes: str) -> Callable[[str], None]:
    def check(value: str) -> None:
        of_other = "container:" in modes and re.fullmatch(
            r"(container|service):[a-zA-Z0-9][a-zA-Z0-9_.-]*", value, re.ASCII
        )
        if value and (value not in modes or value.endswith(":")) and not of_other:
            names = ", ".join(f"{m}NAME" if m.endswith(":") else m for m in modes)
            raise ValueError(f"'{value}' is not known here; write {names}")

    return check


def _security(value: str) -> None:
    key, sign, rest = value.partition("=") if "=" in value else value.partition(":")
    if key == "no-new-privileges" and (not sign or rest in ("true", "false")):
        return
    if not rest or (key not in ("label", "apparmor", "seccomp") and value != "systempaths=unconfined"):
        raise ValueError(f"'{value}' is not a security option; write no-new-privileges, seccomp=, apparmor= or label=")


def _sysctl(name: str) -> None:
    of_kernel = "msgmax|msgmnb|msgmni|sem|shmall|shmmax|shmmni|shm_rmid_forced|domainname"
    if not re.match(rf"(net\.|fs\.mqueue\.|kernel\.({of_kernel})$)", name):
        raise ValueError(f"'{name}' is not namespaced; set it on the host")


def keys(check: Callable[[str], None]) -> AfterValidator:
    """A validator for a mapping: each key must pass the check."""

    def run(value: dict[str, Any]) -> dict[str, Any]:
        for key in value:
            check(key)
        return value

    return AfterValidator(run)


def _key(name: str) -> None:
    if not name:
        raise ValueError("a key is empty")


CAPABILITY, IP, EXTRA_HOST = checked(_capability), checked(_ip), turned(_extra_host)
CPUS, WORKING_DIR, IMAGE = checked(_cpus), checked(_working_dir), checked(check_image)
IPV4, IPV6 = checked(partial(_ip, version=4)), checked(partial(_ip, version=6))
WORD = like(r"(?u:\S+)", "one word")
NETWORK_MODE, SECURITY = checked(_network_mode), checked(_security)
IPC = checked(_namespace("none", "private", "shareable", "host", "service:", "container:"))
PID, HOST_ONLY = checked(_namespace("host", "service:", "container:")), checked(_namespace("host"))
VOLUME, DEVICE, TMPFS = checked(parse_volume), checked(parse_device), checked(parse_tmpfs)
PORTS, EXPOSE = checked(parse_ports), checked(parse_expose)
TARGET, PUBLISHED = checked(check_target), checked(check_published)
VOLUMES_FROM = like(r"(container:)?[a-zA-Z0-9][a-zA-Z0-9_.-]*(:(ro|rw|z|Z))?", "a container; write NAME, or NAME:ro")
DEVICE_RULE = like(r"[acb] ([0-9]+|\*):([0-9]+|\*) [rwm]{1,3}", "a rule for devices; write 'c 188:* rw'")
HOST_NAME = like(r"[a-zA-Z0-9]([a-zA-Z0-9_.-]{0,62}[a-zA-Z0-9])?", "a host name")
DOMAIN = like(r"\.|[a-zA-Z0-9_]([a-zA-Z0-9_.-]*[a-zA-Z0-9_.])?", "a domain")
MAC = like(
    r"([0-9a-fA-F]{2}:){5}[0-9a-fA-F]{2}|([0-9a-fA-F]{2}-){5}[0-9a-fA-F]{2}", "a MAC address; write 02:42:ac:11:00:02"
)
LINK = like(r"[a-zA-Z0-9][a-zA-Z0-9_.-]*(:[a-zA-Z0-9][a-zA-Z0-9_.-]*)?", "a link; write NAME or NAME:ALIAS")
PLATFORM = like(
    r"(?i:linux(/[a-z0-9_]+(/[a-z0-9]+)?)?|amd64|x86_64|386|arm|arm64|aarch64|armhf|riscv64|ppc64le)",
    "a platform; write linux/arm64",
)
PATH = like(r"/[^:]*", "an absolute path")
_NAME = r"(?![0-9]+\.)[a-zA-Z0-9_][a-zA-Z0-9_.-]*\$?"
GROUP = like(_NAME, "a group; write its name or its number")
USER = like(rf"({_NAME}(:{_NAME})?)?", "a user; write NAME, UID or UID:GID")
PARENT = like(r"[a-zA-Z0-9_./@:-]+", "a control group")
RUNTIME = like(r"[a-zA-Z0-9][a-zA-Z0-9_./-]*", "a runtime; write its name, such as runc")
VOLUME_DRIVER = like(r"[a-zA-Z0-9][a-zA-Z0-9_.:/-]*", "a driver of volumes; write its name, such as local")
CONTAINER = like(r"[a-zA-Z0-9][a-zA-Z0-9_.-]+", "a name for a container; write at least two letters or digits")
NETWORK = r"[a-zA-Z0-9][a-zA-Z0-9_.-]*"

VARIABLES = keys(form("[^=]+", "the name of a variable"))
KEYS, SYSCTLS, LIMITS = keys(_key), keys(_sysctl), keys(check_ulimit)
