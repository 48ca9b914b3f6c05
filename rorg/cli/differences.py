"""What is to be done: asked of the running rorg, computed here where none answers or it follows another tree."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from rorg_client import Error as ClientError

from rorg.cli.context import Context
from rorg.cli.terminal import printable
from rorg.errors import Invalid


class Differences(NamedTuple):
    """The plan in both its forms, and of what it was made."""

    text: str
    plan: dict[str, Any]
    empty: bool
    withheld: list[str]
    probed: list[str]
    """Services whose readiness a probe tells."""
    fingerprint: str
    told: bool
    """By the running rorg, which follows this tree."""
    decision: Any = None
    """Where it was computed here."""
    tree: Any = None
    """The same, as it was read."""


def differences(context: Context) -> Differences:
    """Raises Invalid where the tree has errors, and Unreachable."""
    if context.directory and not context.directory.is_dir():
        raise Invalid(
            f"read manifests in {context.directory}", "no such directory", "the directory that holds services/"
        )
    found = _told(context)
    if found is None:
        return _computed(context)
    if found["errors"]:
        raise Invalid(
            f"use the manifests in {found['root']}",
            f"{len(found['errors'])} error(s)\n" + "\n".join(_line(d) for d in found["errors"]) + "\n",
            "`rorg validate` after mending them",
        )
    if found["requests_errors"]:
        raise Invalid(f"read {context.state.requests}", found["requests_errors"][0], "to mend it")
    return Differences(
        text=found["text"],
        plan=found["plan"],
        empty=found["empty"],
        withheld=found["withheld"],
        probed=found["probed"],
        fingerprint=found["fingerprint"],
        told=True,
    )


def _told(context: Context) -> dict[str, Any] | None:
    """What the running rorg says; None where it says nothing of this tree."""
    if context.remote and context.directory:
        context.here("compare that directory")
    client = context.client()
    try:
        found: dict[str, Any] | None = client.call("GET", "/v1/diff") if client else None
    except ClientError:
        if context.remote:
            raise
        return None  # it may be an older one, or one that we may not ask: what is wrong is told by looking ourselves
    other = found and context.directory and Path(found["root"]) != context.directory.resolve()
    return None if other else found


def _line(error: dict[str, Any]) -> str:
    tail = f"; try {error['remedy']}" if error["remedy"] else ""
    place = f"{error['file']}:{error['line']}:{error['column']}"
    return printable(f"{place}: {error['severity']}: {error['message']}{tail}")


def _computed(context: Context) -> Differences:
    from rorg.cli.local import decision_for
    from rorg.daemon.wiring import make_tree
    from rorg.manifest.load import unusable

    tree = make_tree(context.root, context.state)
    tree.read_now()
    if not tree.loaded:
        raise unusable(context.root, tree.errors)
    catalog, decision = tree.desired.catalog, decision_for(context, tree.desired)
    return Differences(
        text=decision.plan.text(),
        plan=decision.plan.as_json(),
        empty=decision.plan.empty,
        withheld=sorted(decision.situation.withheld),
        probed=sorted(name for name, service in catalog.services.items() if service.ready),
        fingerprint=catalog.fingerprint,
        told=False,
        decision=decision,
        tree=tree,
    )
