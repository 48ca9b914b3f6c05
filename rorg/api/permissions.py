"""Who calls, and what they may: one table; everything else is refused."""

from __future__ import annotations

import contextlib
import grp
import os
import pwd
import socket
import struct
from dataclasses import dataclass, replace

from rorg.api import changes
from rorg.errors import Forbidden
from rorg.model.catalog import DEVELOPER, EVERY, Catalog, Service

BOTH, PEOPLE, MACHINES = ("developer", "service"), ("developer",), ("machine",)
ALL, READERS = (*BOTH, *MACHINES), (*PEOPLE, *MACHINES)
_TABLE = {
    "read": (ALL, "see how services are"),
    "request": (BOTH, "request services"),
    "restart": (BOTH, "restart services"),
    "suspend": (PEOPLE, "suspend rorg"),
    "manifests": (BOTH, "see or change manifests"),
    "removals": (PEOPLE, "confirm removals"),
    "fetch": (PEOPLE, "fetch manifests"),
    "link": (MACHINES, "speak for a machine"),
    "take": (PEOPLE, "take services over"),
    "down": (PEOPLE, "take the robot down"),
    "plan": (READERS, "see status and plan"),
    "logs": (READERS, "read logs"),
    "events": (ALL, "see events"),
    "report": (BOTH, "report the graph of ROS 2"),
    "history": (READERS, "see the history"),
    **{operation.name: (PEOPLE, operation.words) for operation in changes.OPERATIONS.values()},
}
"""Operation -> who may, and the words for "cannot X"."""
OPERATIONS = {operation: callers for operation, (callers, _) in _TABLE.items()}
"""Operation -> the kinds of caller that may. A service may only request for itself, or for those it may act for, and
only what the requester's manifest says (`may_request`, `may_restart`, `may_manage`); it sees only events about its own
requests and what they name."""


SO_PEERGROUPS = 59
"""Of Linux; Python has no name for it."""
MOST_GROUPS = 256
"""The most groups that Python can ask for."""


@dataclass(frozen=True, slots=True)
class Caller:
    """Who is at the other end of a connection."""

    kind: str = "nobody"
    """developer, service, machine or nobody."""
    service: str = ""
    """Its name, or that of the machine."""
    uid: int = -1
    pid: int = 0
    certificate: str = ""
    """Common name of a TLS client certificate."""
    via: str = ""
    """The service that acts for this caller."""
    at: str = ""
    """The machine that is asked through this one."""

    @property
    def author(self) -> str:
        """The name for events and commits."""
        if self.via:
            return f"{self.requester} by way of {self.via}"
        if self.kind == "service":
            return self.service
        if self.certificate:
            return self.certificate
        try:
            return pwd.getpwuid(self.uid).pw_name if self.uid >= 0 else "nobody"
        except KeyError:
            return f"uid {self.uid}"

    @property
    def identity(self) -> str:
        """The caller itself, not the one for whom it acts: a service, a certificate or a user."""
        if self.via or self.kind == "service":
            return self.via or self.service
        return f"certificate {self.certificate}" if self.certificate else f"uid {self.uid}"

    @property
    def person(self) -> bool:
        """Whether a person calls, directly or through a program, rather than a service acting for one."""
        return self.kind == "developer" and not self.via

    @property
    def requester(self) -> str:
        return self.service if self.kind == "service" else DEVELOPER


def peer(connection: socket.socket | None, group: int | None) -> Caller:
    """The caller behind a connection to the main socket, as the kernel reports it (SO_PEERCRED): root, the user who
    runs rorg, and members of the group act as developer."""
    if connection is None or connection.family != socket.AF_UNIX:
        return Caller()
    size = struct.calcsize("3i")
    pid, uid, gid = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size))
    trusted = uid in (0, os.geteuid()) or (group is not None and group in _groups(connection, uid, gid))
    return Caller("developer" if trusted else "nobody", uid=uid, pid=pid)


def _groups(connection: socket.socket, uid: int, gid: int) -> set[int]:
    """The groups of the process, which may differ from what the machine's files say about its user; and those of the
    files."""
    groups = {gid}
    with contextlib.suppress(OSError):  # ERANGE if it has more groups than that
        numbers = connection.getsockopt(socket.SOL_SOCKET, SO_PEERGROUPS, 4 * MOST_GROUPS)
        groups |= set(struct.unpack(f"{len(numbers) // 4}I", numbers))
    with contextlib.suppress(KeyError):
        groups |= set(os.getgrouplist(pwd.getpwuid(uid).pw_name, gid))
    return groups


def group_id(name: str) -> int | None:
    """The number of a group, given by name or number; None if there is no group of that name."""
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        return int(name) if name.isdecimal() else None


def allow(caller: Caller, operation: str) -> None:
    """Raises Forbidden unless the table says that this kind of caller may."""
    if caller.kind not in OPERATIONS[operation]:
        who = {"service": f"the service {caller.service}", "developer": "a developer"}.get(caller.kind, caller.author)
        remedy = "as a member of rorg's group" + (
            f", or `may_{operation}` in the manifest" if operation in ("request", "restart") else ""
        )
        raise Forbidden(_TABLE[operation][1], f"{who} may not", remedy)


MACHINE = "machine-"
"""Common names that begin so are never those of people."""


def certified(caller: Caller, catalog: Catalog) -> Caller:
    """The caller behind a certificate: a machine of the robot, or a person. A machine that the manifests do not name
    has no rights."""
    machine = next((m.name for m in catalog.machines.values() if m.certificate == caller.certificate), "")
    if machine:
        return replace(caller, kind="machine", service=machine)
    return replace(caller, kind="nobody") if caller.certificate.startswith(MACHINE) else caller


def allow_call(caller: Caller, catalog: Catalog) -> None:
    """Raises Forbidden for a service whose manifest no longer gives it a socket: it may still have a connection."""
    declared = catalog.services.get(caller.service)
    if caller.kind == "service" and not (declared and declared.calls):
        raise Forbidden("call rorg", f"the manifest of {caller.service} gives it nothing to ask for", "`may_request`")


def acting(caller: Caller, name: str, catalog: Catalog) -> Caller:
    """The caller for whom a service acts, with that one's permissions. Raises Forbidden if it may not act for it."""
    declared = catalog.services.get(caller.service)
    named = declared.may_act_for if declared else ()
    allowed = {m for other in named for m in catalog.members(other)}
    if EVERY in named:
        allowed |= set(catalog.services) - {DEVELOPER}
    if name not in allowed:
        raise Forbidden(
            f"request as {name}",
            f"{caller.service} may only request for itself" + (f", {', '.join(named)}" if named else ""),
            f"no requester, or `may_act_for: [{name}]` in its manifest",
        )
    who = Caller("developer") if name == DEVELOPER else Caller("service", service=name)
    return replace(who, via=caller.service)


def allow_request(
    caller: Caller, requester: str, services: tuple[str, ...], catalog: Catalog, priority: int | None = None
) -> None:
    """Raises Forbidden if a service requests in another's name, or what its manifest does not allow, or with a higher
    priority than its own."""
    allow(caller, "request")
    if caller.kind != "service":
        return
    if requester != caller.service:
        raise Forbidden(f"request as {requester}", f"{caller.service} may only request for itself", "no requester")
    _within(caller, "request", services, catalog)
    declared = catalog.services.get(caller.service)
    if declared and priority is not None and priority > declared.priority:
        raise Forbidden(
            f"request {', '.join(services)}",
            f"{caller.service} asks with priority {priority}, and its own is {declared.priority}",
            f"{declared.priority}, or `priority: {priority}` in its manifest",
        )


def allow_report(caller: Caller, catalog: Catalog) -> None:
    """Raises Forbidden unless the service's manifest says that it may report the graph of ROS 2."""
    allow(caller, "report")
    declared = catalog.services.get(caller.service)
    if caller.kind == "service" and not (declared and declared.may_report_graph):
        why = f"the manifest of {caller.service} does not say so"
        raise Forbidden("report the graph of ROS 2", why, "`may_report_graph: true` in its manifest")


def allow_restart(caller: Caller, name: str, catalog: Catalog) -> None:
    """Raises Forbidden if a service restarts what its manifest does not name."""
    allow(caller, "restart")
    if caller.kind == "service":
        _within(caller, "restart", (name,), catalog)


def allow_manage(caller: Caller, kind: str, name: str, catalog: Catalog) -> None:
    """Raises Forbidden if a service may not see or change a manifest."""
    allow(caller, "manifests")
    if caller.kind == "service" and not manages(caller, kind, name, catalog):
        declared = catalog.services.get(caller.service)
        patterns = ", ".join(declared.may_manage) if declared and declared.may_manage else "nothing"
        raise Forbidden(
            f"manage the {kind} '{name}'" if name else "see manifests",
            f"{caller.service} may manage {patterns}",
            f"may_manage: [{name or 'NAME'}] in its manifest",
        )


def manages(caller: Caller, kind: str, name: str, catalog: Catalog) -> bool:
    """Whether a caller may see and change this manifest; without a name, whether any."""
    if caller.kind != "service":
        return caller.kind == "developer"
    declared = catalog.services.get(caller.service)
    return declared is not None and (
        declared.manages(name) and kind == "Service" if name else bool(declared.may_manage)
    )


def permitted(service: Service, verb: str, catalog: Catalog) -> set[str]:
    """The services that a service may request, or restart: those that its manifest names, and those that it manages."""
    return {
        *(m for name in getattr(service, f"may_{verb}") for m in catalog.members(name)),
        *(n for n in catalog.services if service.manages(n)),
    }


def _within(caller: Caller, verb: str, services: tuple[str, ...], catalog: Catalog) -> None:
    declared = catalog.services.get(caller.service)
    allowed = permitted(declared, verb, catalog) if declared else set()
    beyond = [s for s in services if not set(catalog.members(s)) <= allowed]
    if beyond:
        raise Forbidden(
            f"{verb} {', '.join(beyond)}",
            f"{caller.service} may {verb} {', '.join(sorted(allowed)) or 'nothing'}",
            f"may_{verb}: [{beyond[0]}] in its manifest",
        )
