"""Expands short forms of Compose files into their long forms."""

from __future__ import annotations

import re
from typing import Any

from rorg.tools.compose.form import Context
from rorg.tools.compose.nodes import Node
from rorg.tools.compose.scalars import LOOSE, TEXT

_PORT = re.compile(
    r"(?:(?P<ip>\[[0-9a-fA-F:.]+\]|[0-9.]+|[0-9a-fA-F:]*::[0-9a-fA-F:]*?):(?=[0-9-]*:))?"
    r"(?:(?P<published>[0-9]+(?:-[0-9]+)?)?:)?(?P<target>[0-9]+(?:-[0-9]+)?)(?:/(?P<protocol>[a-z]+))?$"
)
CDI = re.compile(r"[A-Za-z0-9_.-]+/[A-Za-z0-9_.-]+=[A-Za-z0-9_.:-]+")
"""The name of a device of the Container Device Interface: VENDOR/CLASS=DEVICE."""
PROPAGATION = ("private", "rprivate", "shared", "rshared", "slave", "rslave")
_MOUNT_FLAGS = (*PROPAGATION, "ro", "rw", "z", "Z", "nocopy", "cached", "delegated", "consistent")


def made(node: Node, value: Any) -> Node:
    """Plain values as nodes, all at the place of the node that they come from."""
    if isinstance(value, dict):
        return node.but({key: _inner(node, one) for key, one in value.items()}, tag="")
    return _inner(node, value)


def _inner(node: Node, value: Any) -> Node:
    inner = Node(value, node.where, taken=node.taken)
    if isinstance(value, dict):
        inner.value = {key: _inner(node, one) for key, one in value.items()}
    elif isinstance(value, list):
        inner.value = [_inner(node, one) for one in value]
    return inner


def named(key: str) -> Any:
    """A text stands for a mapping with this key: `build: .`, `extends: base`, `secrets: [token]`."""
    return lambda node, _name, _context: made(node, {key: node.value})


def names(node: Node, name: str, context: Context) -> Node:
    """`[NAME]`: names without values."""
    read = [TEXT.read(item, f"{name}[{index}]", context) for index, item in enumerate(node.items)]
    return node.but({one.value: Node(None, one.where, one.where, taken=one.taken) for one in read if one})


def pairs(node: Node, name: str, context: Context) -> Node:
    """`[NAME=value]`; a bare NAME has no value."""
    by_name: dict[str, Node] = {}
    for index, item in enumerate(node.items):
        if read := LOOSE.read(item, f"{name}[{index}]", context):
            key, separator, value = read.value.partition("=")
            by_name[key] = Node(value if separator else None, item.where, item.where, taken=item.taken)
    return node.but(by_name)


def depends_on(node: Node, name: str, context: Context) -> Node:
    """`[SERVICE]`: each of them is started first."""
    dependencies: dict[str, Node] = {}
    for index, item in enumerate(node.items):
        if isinstance(item.value, str):
            dependencies[item.value] = made(item, {"condition": "service_started", "required": True})
            dependencies[item.value].key = item.where
        else:
            context.error(item, f"{name}[{index}] is {item.kind()}, and must be the name of a service")
    return node.but(dependencies)


def ports(node: Node, name: str, context: Context) -> list[Node]:
    """`[[IP:]PUBLISHED:]TARGET[/PROTOCOL]`, where both may be ranges: one long form for each port."""
    if isinstance(node.value, dict):
        return [node]
    text = str(node.value) if isinstance(node.value, str | int) else ""
    match = _PORT.match(text)
    remedy = '"8080:80", "127.0.0.1:8080:80/udp", or {target: 80, published: "8080"}'
    if not match or isinstance(node.value, bool):
        context.error(node, f"{name}: '{node.plain()}' is not a port", remedy)
        return []
    targets, published = _range(match["target"]), _range(match["published"])
    if targets is None or published is None or (len(targets) > 1 and len(published) not in (0, len(targets))):
        context.error(node, f"{name}: the ranges of '{text}' do not fit", "ranges of equal length, within 1-65535")
        return []
    context.files.spend(5 * len(targets), node.where)
    fixed: dict[str, Any] = {"mode": "ingress", "protocol": match["protocol"] or "tcp"}
    if match["ip"]:
        fixed["host_ip"] = match["ip"].strip("[]")
    if len(targets) == 1 and len(published) > 1:
        return [made(node, {**fixed, "target": targets[0], "published": match["published"]})]
    return [
        made(node, {**fixed, "target": port, **({"published": str(published[i])} if published else {})})
        for i, port in enumerate(targets)
    ]


def _range(text: str | None) -> list[int] | None:
    """The ports of `8000` or `8000-8010`; None if they are not valid."""
    if not text:
        return []
    first, _, last = text.partition("-")
    numbers = range(int(first), int(last or first) + 1)
    return list(numbers) if numbers and numbers[-1] <= 65535 else None


def is_path(source: str) -> bool:
    """Whether the source of a volume's short form is a path instead of a name."""
    return source.startswith((".", "/", "~"))


def volume(node: Node, name: str, context: Context) -> Node | None:
    """`[SOURCE:]TARGET[:FLAG,...]`. A source that does not start with `.`, `/` or `~` is the name of a volume."""
    text = node.value
    parts = text.split(":")
    if len(parts) > 3 or not all(parts):
        context.error(node, f"{name}: '{text}' is not a volume", "SOURCE:TARGET, SOURCE:TARGET:ro, or a mapping")
        return None
    if len(parts) == 1:
        return made(node, {"type": "volume", "target": text, "volume": {}})
    source, target, *rest = parts
    flags = rest[0].split(",") if rest else []
    for flag in flags:
        if flag not in _MOUNT_FLAGS:
            context.error(node, f"{name}: '{flag}' is not a flag of volumes", f"one of {', '.join(_MOUNT_FLAGS)}")
            return None
    mount: dict[str, Any] = {"source": source, "target": target}
    if "ro" in flags:
        mount["read_only"] = True
    if not is_path(source):
        return made(node, {"type": "volume", **mount, "volume": {"nocopy": True} if "nocopy" in flags else {}})
    bind: dict[str, Any] = {"create_host_path": True}
    for flag in flags:
        if flag in PROPAGATION:
            bind["propagation"] = flag
        elif flag in ("z", "Z"):
            bind["selinux"] = flag
    return made(node, {"type": "bind", **mount, "bind": bind})


def device(node: Node, name: str, context: Context) -> Node | None:
    """`SOURCE[:TARGET[:PERMISSIONS]]`, `SOURCE:PERMISSIONS` as of `docker run`, or the CDI name of a device."""
    parts = [node.value] if CDI.fullmatch(node.value) else node.value.split(":")
    if len(parts) == 2 and re.fullmatch("[rwm]{1,3}", parts[1]):
        parts.insert(1, parts[0])
    if len(parts) > 3 or not all(parts):
        context.error(node, f"{name}: '{node.value}' is not a device", "SOURCE, SOURCE:TARGET, or SOURCE:TARGET:rwm")
        return None
    return made(node, dict(zip(("source", "target", "permissions"), parts, strict=False)))


def whole_device(node: Node, _name: str, _context: Context) -> Node:
    """Completes a device: without a target, it has the same path in the container."""
    return node if "target" in node.mapping else node.having(target=node.get("source"))


def count(value: Any) -> int:
    """A number of devices; `all` is -1. Raises ValueError."""
    if value == "all":
        return -1
    if isinstance(value, str) and not re.fullmatch("[0-9]+", value):
        raise ValueError(f"'{value}' is neither a number nor 'all'")
    return int(value)


def health_test(node: Node, _name: str, _context: Context) -> Node:
    """A single line, which a shell runs."""
    return made(node, ["CMD-SHELL", node.value])


def hosts(node: Node, name: str, context: Context) -> Node:
    """`[HOST=ADDRESS]`, `[HOST:ADDRESS]`, or `{HOST: ADDRESS}`, also with a list of addresses: `[HOST=ADDRESS]`."""
    entries: list[Node] = []
    for host, item in node.mapping.items():
        addresses = item.items if isinstance(item.value, list) else [item]
        entries += [address.but(f"{host}={address.plain()}") for address in addresses]
    for index, item in enumerate(node.items):
        read = LOOSE.read(item, f"{name}[{index}]", context)
        if read is None:
            continue
        line = re.fullmatch(r"([^=:]+)[=:](.+)", read.value, re.DOTALL)
        if line is None:
            context.error(item, f"{name}: '{read.value}' is not a host with an address", "HOST=ADDRESS")
        else:
            entries.append(read.but(f"{line[1]}={line[2].strip('[]')}"))
    return node.but(entries)


def external(node: Node, name: str, context: Context) -> Node:
    """`external: {name: NAME}` of old files means `external: true` with that name."""
    entries = dict(node.value)
    outside = entries.get("external")
    if outside is not None and isinstance(outside.value, dict):
        if "name" in outside.value:
            entries.setdefault("name", outside.value["name"])
        entries["external"] = outside.but(True)
    elif outside is not None and outside.value is False:
        del entries["external"]
    if "external" in entries:
        for key, value in entries.items():
            if key not in ("name", "external") and not key.startswith("x-"):
                message = f"{name} is external, so it cannot have '{key}' here"
                context.error(value, message, f"to remove '{key}' or 'external'", key=True)
    return node.but(entries)


def listed_pairs(node: Node, _name: str, _context: Context) -> Node:
    """`{KEY: VALUE}` as `[KEY=VALUE]`."""
    return node.but([v.but(key if v.value is None else f"{key}={v.value}") for key, v in node.mapping.items()])


def all_gpus(node: Node, name: str, context: Context) -> Node | None:
    """`gpus: all`."""
    if node.value != "all":
        context.error(node, f"{name}: '{node.value}' is not known", "'all', or a list of devices")
        return None
    return node.but([made(node, {"count": -1})])
