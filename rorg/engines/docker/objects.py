"""Networks and volumes of the engine: finding, making and removing them. Only those with our label are removed."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from rorg.core.digest import declared_of
from rorg.core.objects import LABELS, found_object
from rorg.core.observed import LABEL_DECLARED, LABEL_OWNER, FoundObject, FoundObjects
from rorg.engines.docker.answers import from_json
from rorg.engines.docker.body import endpoint
from rorg.engines.docker.client import Client
from rorg.engines.docker.create import other_rorg
from rorg.engines.docker.errors import Refused
from rorg.engines.docker.inspection import state_of
from rorg.engines.log_lines import Reading
from rorg.errors import EngineError
from rorg.model.objects import Kind, subject

Body = dict[str, Any]
PATIENCE = 10.0
"""Seconds for the list of volumes."""
EVENTS = ("create", "destroy", "remove")
"""Events after which there is one more, or one less."""


def find(client: Client, owner: str, keys: Collection[str]) -> FoundObjects:
    """All of `owner`, and everything whose name is one of `keys`, in two calls. The engine asks each volume driver, and
    waits for one that hangs: then nothing is known of volumes, but networks go on."""
    rows: list[FoundObject] = []
    for row in client.get("/networks"):
        rows.append(found_object("network", row["Name"], row["Id"], row.get("Labels") or {}))
    asked, error = frozenset(keys), ""
    try:
        for row in client.get("/volumes", PATIENCE)["Volumes"] or ():
            rows.append(found_object("volume", row["Name"], row["Name"], row.get("Labels") or {}))
    except TimeoutError:
        asked = frozenset(key for key in asked if not key.startswith(subject("volume", "")))
        error = f"the engine has not listed its volumes within {PATIENCE:g} s"
    # Two networks may have the same name: ours counts.
    rows.sort(key=lambda one: one.owner == owner)
    objects = {one.key: one for one in rows if one.owner == owner or one.key in asked}
    return FoundObjects(objects, asked, complete=True, error=error)


def events(client: Client, stop: Reading) -> Iterator[None]:
    """One item when the stream begins, and one for each that comes or goes. The events have no labels."""
    filters = {"type": ["network", "volume"], "event": list(EVENTS)}
    with (
        client.stream("GET", "/events", filters=filters, since=client.just_now()) as stream,
        stop.closing(stream.close),
    ):
        yield
        for line in stream.lines():
            if from_json(line).get("Action") in EVENTS:
                yield


def make(client: Client, kind: Kind, name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> None:
    """Make one. The engine returns an existing volume as if it were new: its labels tell whose it is."""
    if kind == "network":
        client.post("/networks/create", network_body(name, spec, labels))
        if client.release.podman:
            _connect_resting(client, name, labels[LABEL_OWNER])
        return
    made = client.post("/volumes/create", volume_body(name, spec, labels))
    if (made.get("Labels") or {}).get(LABEL_OWNER) != labels[LABEL_OWNER]:
        whose = other_rorg(made.get("Labels") or {}, labels[LABEL_OWNER])
        why = (
            f"a volume of that name belongs to {whose}" if whose else "a volume of that name exists that is not rorg's"
        )
        raise EngineError(f"create the volume {name}", why, "external: true")


def remove(client: Client, kind: Kind, name: str, owner: str) -> None:
    """Remove one of `owner`, if it still exists. Raises EngineError of kind `in_use` while anything is connected, and
    of kind `foreign` for one of another owner."""
    what = f"remove the {kind} {name}"
    data = client.find(f"/{kind}s/{name}")
    if data is None:
        return
    labels = data.get("Labels") or {}
    if labels.get(LABEL_OWNER) != owner or LABELS[kind] not in labels:
        whose = other_rorg(labels, owner)
        raise EngineError(what, f"it belongs to {whose}" if whose else "it is not rorg's", kind="foreign")
    joined = data.get("Containers") or {}
    resting = [id for id in joined if _rests(client, id, owner)] if client.release.podman else []
    users = sorted(c.get("Name", "") for id, c in joined.items() if id not in resting)
    if users:
        raise EngineError(what, f"connected to it: {', '.join(users)}", "to stop these", kind="in_use")
    for id in resting:  # Podman counts them as users; they do not start before the next network of this name is made
        client.post(f"/networks/{name}/disconnect", {"Container": id, "Force": True})
    try:
        client.delete(f"/{kind}s/{data['Id'] if kind == 'network' else name}")
    except Refused as no:
        if no.status == 404:
            return
        if no.status in (403, 409):
            raise EngineError(what, no.text, "to remove the containers that use it", kind="in_use") from no
        raise


def _rests(client: Client, container: str, owner: str) -> bool:
    """Whether a container of `owner` does not run, or is gone."""
    data = client.find(f"/containers/{container}/json")
    if data is None:
        return True
    ours = (data["Config"].get("Labels") or {}).get(LABEL_OWNER) == owner
    return ours and state_of(data["State"]["Status"]) in ("created", "exited")


def _connect_resting(client: Client, network: str, owner: str) -> None:
    """Connect the containers that were disconnected when the previous network of this name was removed."""
    for row in client.get("/containers/json", all=True, filters={"label": [f"{LABEL_OWNER}={owner}"]}):
        wanted = declared_of(row["Labels"].get(LABEL_DECLARED, "")).get("networks") or {}
        if network in wanted and network not in (row["NetworkSettings"].get("Networks") or {}):
            said = {"Container": row["Id"], "EndpointConfig": endpoint(wanted[network] or {})}
            client.post(f"/networks/{network}/connect", said)


def network_body(name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> Body:
    """The body of POST /networks/create, with only what is declared."""
    body: Body = {"Name": name, "CheckDuplicate": True, "Labels": dict(labels)}
    names = {
        "driver": "Driver",
        "driver_opts": "Options",
        "internal": "Internal",
        "attachable": "Attachable",
        "enable_ipv6": "EnableIPv6",
    }
    body |= {api: spec[option] for option, api in names.items() if option in spec}
    if "ipam" in spec:
        body["IPAM"] = _ipam(spec["ipam"])
    return body


def _ipam(value: Mapping[str, Any]) -> Body:
    names = {
        "subnet": "Subnet",
        "gateway": "Gateway",
        "ip_range": "IPRange",
        "aux_addresses": "AuxiliaryAddresses",
    }
    pools = [{api: pool[option] for option, api in names.items() if option in pool} for pool in value.get("config", [])]
    more = {"Options": dict(value["options"])} if "options" in value else {}
    return {"Driver": value.get("driver", "default"), "Config": pools, **more}


def volume_body(name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> Body:
    """The body of POST /volumes/create, likewise."""
    body: Body = {"Name": name, "Labels": dict(labels)}
    names = {"driver": "Driver", "driver_opts": "DriverOpts"}
    return {**body, **{api: spec[option] for option, api in names.items() if option in spec}}
