"""What Compose creates of a project and what rorg creates of the imported one, in one form, by the engine's inspection.

Left out is what each of them does in its own way: names of the engine for what has none, ids, labels of Compose and of
rorg, and the engine's restart policy, since rorg restarts services itself.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

Tree = dict[str, Any]
BASE = "agreement-base"
"""The image that all others of the cases are tags of: it has a command, so that services need none."""
FOREIGN = ("com.docker.compose.", "rorg.io/")
LEFT_OUT = {
    *("ContainerIDFile", "ConsoleSize", "RestartPolicy", "Binds", "Mounts", "NetworkMode", "PidMode", "IpcMode"),
    *("VolumesFrom", "Links", "Isolation", "AutoRemove", "PortBindings"),
}
"""Of HostConfig: compared in another form, or no matter of either."""
NOTHING = (None, "", 0, False, [], {})


def needed(config: Mapping[str, Any]) -> Tree:
    """What of a project's configuration is asked for again, when it is compared."""
    kept = {"name": config["name"], "images": sorted(images_of(config))}
    return kept | {k: config[k] for k in ("networks", "volumes") if config.get(k)}


def make_external(api: Any, config: Mapping[str, Any]) -> None:
    """The networks and volumes that a project takes for granted."""
    for said in _external(config, "networks"):
        if not api.networks([said["name"]]):
            api.create_network(said["name"])
    for said in _external(config, "volumes"):
        api.create_volume(said["name"])


def remove_external(api: Any, config: Mapping[str, Any]) -> None:
    for said in _external(config, "networks"):
        api.remove_network(said["name"])
    for said in _external(config, "volumes"):
        api.remove_volume(said["name"])


def _external(config: Mapping[str, Any], kind: str) -> list[Mapping[str, Any]]:
    builtin = ("host", "none", "bridge")
    return [v for v in (config.get(kind) or {}).values() if v.get("external") and v["name"] not in builtin]


def images_of(config: Mapping[str, Any]) -> set[str]:
    """The references that services of a project are made from, as `docker compose config` answers."""
    services = config.get("services") or {}
    return {service.get("image") or f"{config['name']}-{name}" for name, service in services.items()}


def make_images(api: Any, references: Iterable[str]) -> None:
    """Tags the stand-in by all these names; BASE itself is there already, or made of the tests' base."""
    from common import BASE_IMAGE

    if not api.images(BASE):
        made = api.create_container(BASE_IMAGE, ["true"])["Id"]
        api.commit(made, BASE, changes=['CMD ["sleep", "1"]'])
        api.remove_container(made)
    for reference in references:
        name, _, tag = reference.rpartition(":") if ":" in reference.rpartition("/")[2] else (reference, "", "latest")
        api.tag(BASE, name, tag)


def project(api: Any, names: Iterable[str], config: Mapping[str, Any], folder: Path) -> Tree:
    """All that there is of a project: containers of these names, and the networks and volumes of its configuration."""
    found = {name: api.inspect_container(name) for name in sorted(names)}
    plain = _plain(api)
    ids = {data["Id"]: name for name, data in found.items()}
    networks = {n["name"]: n for n in (config.get("networks") or {}).values()}
    volumes = [v["name"] for v in (config.get("volumes") or {}).values()]
    there = {n["Id"]: n["Name"] for n in api.networks()}
    known = {v["Name"] for v in api.volumes()["Volumes"] or ()}
    return {
        "containers": _named({name: container(data, plain, ids, there, folder) for name, data in found.items()}),
        "networks": {n: network(api.inspect_network(n), networks[n]) for n in sorted(networks) if n in there.values()},
        "volumes": {n: volume(api.inspect_volume(n)) for n in sorted(volumes) if n in known},
    }


def network(data: Mapping[str, Any], said: Mapping[str, Any]) -> Tree:
    """A network. What the engine chooses of addresses is no matter."""
    ipam = data.get("IPAM") or {}
    config = ipam.get("Config") if (said.get("ipam") or {}).get("config") else None
    return _full(
        {
            "driver": data["Driver"],
            "options": data.get("Options"),
            "internal": data.get("Internal"),
            "attachable": data.get("Attachable"),
            "ipv6": data.get("EnableIPv6"),
            "ipam": [_full(c) for c in config or ()],
            "labels": _labels(data),
        }
    )


def volume(data: Mapping[str, Any]) -> Tree:
    return _full({"driver": data["Driver"], "options": data.get("Options"), "labels": _labels(data)})


def _named(containers: Tree) -> Tree:
    """With links as what they are to rorg: further names of the other container on a network."""
    for data in containers.values():
        for name, endpoint in data.get("Networks", {}).items():
            for link in endpoint.pop("links", ()):
                other, _, alias = link.partition(":")
                if other not in containers:
                    continue  # another project's: rorg refuses these
                there = containers[other]["Networks"][name]
                there["aliases"] = sorted({*there.get("aliases", ()), alias})
    return containers


def _plain(api: Any) -> Mapping[str, Any]:
    """HostConfig of a container of which nothing is said, and which is not kept: what is as there is the engine's."""
    made = api.create_container(BASE, host_config=api.create_host_config())["Id"]
    found = api.inspect_container(made)["HostConfig"]
    api.remove_container(made)
    return found


def container(
    data: Mapping[str, Any],
    plain: Mapping[str, Any],
    ids: Mapping[str, str],
    networks: Mapping[str, str],
    folder: Path,
) -> Tree:
    """A container. `plain`: HostConfig where nothing is said; `ids`, `networks`: id -> name, of its containers
    and of all networks; `folder`: that of the Compose file."""
    config, host = data["Config"], data["HostConfig"]
    name, short = data["Name"].lstrip("/"), data["Id"][:12]
    said = {key: config.get(key) for key in ("Cmd", "Entrypoint", "User", "WorkingDir", "Domainname", "Tty")}
    said |= {key: config.get(key) for key in ("OpenStdin", "StopSignal", "StopTimeout", "Healthcheck", "MacAddress")}
    said["Image"] = config["Image"]
    given = {id[:12] for id in ids}  # its own, or once it runs that of the container whose network it has
    said["Hostname"] = None if config["Hostname"] in given else config["Hostname"]
    said["Env"] = sorted(e for e in config.get("Env") or () if "=" in e)  # a name alone sets nothing
    said["ExposedPorts"] = sorted(p if "/" in p else f"{p}/tcp" for p in config.get("ExposedPorts") or ())
    said["Labels"] = _labels(config)
    said["Healthcheck"] = _full(config.get("Healthcheck") or {})
    said["Mounts"] = sorted((_mount(m, folder) for m in data["Mounts"]), key=lambda m: m["target"])
    said["MountOptions"] = _mount_options(host)
    said["Ports"] = {
        k: sorted(f"{b['HostIp']}:{b['HostPort']}" for b in v) for k, v in (host["PortBindings"] or {}).items()
    }
    said["NetworkMode"] = networks.get(host["NetworkMode"], _joined(host["NetworkMode"], ids))
    for key in ("PidMode", "IpcMode"):
        said[key] = _joined(host.get(key) or "", ids) if host.get(key) != plain.get(key) else ""
    said["VolumesFrom"] = sorted(_of(v, ids) for v in host.get("VolumesFrom") or ())
    said["Networks"] = {n: _endpoint(e, name, short) for n, e in data["NetworkSettings"]["Networks"].items()}
    own, usual = ({k: _host(k, v) for k, v in of.items() if k not in LEFT_OUT} for of in (host, plain))
    said["HostConfig"] = {k: v for k, v in sorted(own.items()) if (v or None) != (usual.get(k) or None)}
    return json.loads(json.dumps(_full(said)).replace(str(folder), "."))


def _full(value: Mapping[str, Any]) -> Tree:
    return {k: v for k, v in sorted(value.items()) if v not in NOTHING}


def _labels(data: Mapping[str, Any]) -> Tree:
    return {k: v for k, v in sorted((data.get("Labels") or {}).items()) if not k.startswith(FOREIGN)}


def _of(text: str, ids: Mapping[str, str]) -> str:
    """With the name of a container in the place of its id."""
    head, colon, tail = text.removeprefix("container:").partition(":")
    return f"{ids.get(head, head)}{colon}{tail}".removesuffix(":rw")


def _joined(mode: str, ids: Mapping[str, str]) -> str:
    return f"container:{_of(mode, ids)}" if mode.startswith("container:") else mode


def _mount(data: Mapping[str, Any], folder: Path) -> Tree:
    unnamed = data["Type"] == "volume" and re.fullmatch(r"[0-9a-f]{64}", data.get("Name") or "")
    source = data["Source"] if data["Type"] == "bind" else "" if unnamed else data.get("Name", "")
    return {
        "type": data["Type"],
        "source": source,
        "target": os.path.normpath(data["Destination"]),
        "writable": data["RW"],
        "propagation": "" if data.get("Propagation") == "rprivate" else data.get("Propagation", ""),
    }


def _mount_options(host: Mapping[str, Any]) -> Tree:
    """What inspection tells of mounts only as it was asked for: target -> options."""
    found: Tree = {}
    for bind in host.get("Binds") or ():
        _, target, *modes = bind.split(":")
        if flags := sorted(set(",".join(modes).split(",")) & {"nocopy", "z", "Z"}):
            found[target] = flags
    for mount in host.get("Mounts") or ():
        if (mount.get("VolumeOptions") or {}).get("NoCopy"):
            found[mount["Target"]] = ["nocopy"]
        if options := _full(mount.get("TmpfsOptions") or {}):
            found[mount["Target"]] = options
    return found


def _endpoint(data: Mapping[str, Any], name: str, short: str) -> Tree:
    aliases = sorted(set(data.get("Aliases") or ()) - {name, short})
    ipam = _full(data.get("IPAMConfig") or {})
    links = sorted(link for link in data.get("Links") or () if not _usual(link))
    return _full({"aliases": aliases, "ipam": ipam, "options": data.get("DriverOpts"), "links": links})


def _usual(link: str) -> bool:
    """Whether the other container is called so on the network anyway: by its own name, that of its service, or that
    with its number, which Compose adds."""
    container, _, alias = link.partition(":")
    return alias == container or re.fullmatch(rf".*-{re.escape(alias.removesuffix('-1'))}-1", container) is not None


def _host(key: str, value: Any) -> Any:
    """One field of HostConfig: lists of which the order says nothing are sorted, empty parts are left out."""
    if key in ("CapAdd", "CapDrop"):
        return sorted(v.upper().removeprefix("CAP_") for v in value or ())
    if key == "Ulimits":
        return sorted((u["Name"], u["Soft"], u["Hard"]) for u in value or ())
    if key == "DeviceRequests":
        return [_full(v) for v in value or ()]
    if key in ("ExtraHosts", "GroupAdd", "MaskedPaths", "ReadonlyPaths", "DeviceCgroupRules", "SecurityOpt"):
        return sorted(value or ())
    return {k: v for k, v in sorted(value.items()) if v is not None} if isinstance(value, dict) else value


def differences(compose: Tree, rorg: Tree, at: str = "") -> list[str]:
    """Where two projects are otherwise, a line for each value."""
    if isinstance(compose, dict) and isinstance(rorg, dict):
        keys = sorted({*compose, *rorg})
        return [d for k in keys for d in differences(compose.get(k), rorg.get(k), f"{at}/{k}")]
    return [] if compose == rorg else [f"{at}: Compose {json.dumps(compose)}, rorg {json.dumps(rorg)}"]


def otherwise(case: Path) -> dict[str, str]:
    """Where rorg means to do something else than Compose does: path -> why, from the case's file `otherwise`."""
    file = case / "otherwise"
    lines = file.read_text().splitlines() if file.exists() else []
    return dict(line.split(": ", 1) for line in lines)
