"""What is to be done: asked of the running rorg, computed here where none answers or it follows another tree."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple

from rorg_client import Error as ClientError

from rorg.cli.context import Context, bad_requests
from rorg.cli.output import note
from rorg.cli.terminal import hide, printable
from rorg.errors import Invalid


class Differences(NamedTuple):
    """The plan in its forms, and of what it was made."""

    text: str
    """Step by step."""
    services: list[dict[str, Any]]
    """Service by service."""
    unified: dict[str, str]
    """Of each container that is changed, where it was asked for."""
    plan: dict[str, Any]
    empty: bool
    suspended: str
    """Why nothing of it is done now."""
    root: Path
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

    def overview(self) -> str:
        """One line for each service, and one with the counts."""
        lines = [*(s["line"] for s in self.services), self.plan["summary"]]
        return "".join(f"{line}\n" for line in lines if line)


def differences(context: Context, unified: bool = False) -> Differences:
    """Raises Invalid where the tree has errors, and Unreachable."""
    found = _told(context, unified)
    if found is None:
        return _computed(context, unified)
    if found["errors"]:
        from rorg.model.units import counted

        raise Invalid(
            f"use the manifests in {found['root']}",
            counted(len(found["errors"]), "error") + "\n" + "\n".join(line(d) for d in found["errors"]) + "\n",
            "fixing them, then `rorg validate`",
        )
    if found["requests_errors"]:
        raise bad_requests(context.state.requests, found["requests_errors"][0])
    return _of(found, Path(found["root"]), told=True)


def _of(found: dict[str, Any], root: Path, told: bool) -> Differences:
    forms = {name: found[name] for name in ("text", "services", "unified", "plan", "empty", "suspended")}
    return Differences(
        **forms,
        root=root,
        withheld=found["withheld"],
        probed=found["probed"],
        fingerprint=found["fingerprint"],
        told=told,
    )


def warn_of_other_tree(context: Context, found: Differences) -> None:
    """Says so where the manifests that are compared are not those that somebody may think of."""
    here = Path("manifests")
    if found.told:
        if not (context.remote or context.directory) and here.is_dir() and here.resolve() != found.root:
            note(f"the running rorg follows {found.root}; {here.resolve()} is not looked at")
        return
    last = ((context.last() or {}).get("tree") or {}).get("root")
    if isinstance(last, str) and Path(last) != found.root.resolve():
        runs = "the running rorg follows" if context.state.owner() else "rorg followed"
        note(f"{runs} {last}; this compares {found.root.resolve()}")


def _told(context: Context, unified: bool) -> dict[str, Any] | None:
    """What the running rorg says; None where it says nothing of this tree."""
    if context.directory and context.place.elsewhere:
        context.here("compare that directory")
    client = context.client()
    try:
        found: dict[str, Any] | None = client.call("GET", f"/v1/diff{'?unified=true' * unified}") if client else None
    except ClientError:
        if context.remote:
            raise
        return None  # it may be an older one, or one that we may not ask: what is wrong is told by looking ourselves
    if found and context.directory and Path(found["root"]) != context.directory.resolve():
        context.here("compare that directory")
        return None
    return found if found and "services" in found else None


def line(error: dict[str, Any]) -> str:
    """One finding in a tree, as the API tells it."""
    tail = f"; try {error['remedy']}" if error["remedy"] else ""
    place = f"{error['file']}:{error['line']}:{error['column']}"
    return printable(f"{place}: {error['severity']}: {error['message']}{tail}")


def _computed(context: Context, unified: bool) -> Differences:
    from rorg.api.plan_forms import shown
    from rorg.cli.local import decision_for
    from rorg.daemon.wiring import make_tree
    from rorg.manifest.load import unusable

    if context.directory and not os.path.isdir(context.directory):
        what = f"read manifests in {context.directory}"
        raise Invalid(what, "no such directory", "the directory that holds services/")
    tree = make_tree(context.root, context.state, context.engine_name)
    hide(tree.masker)
    tree.read_now()
    if not tree.loaded:
        raise unusable(context.root, tree.errors)
    decision = decision_for(context, tree.desired)
    found = _of(shown(decision, decision.plan, unified), context.root, told=False)
    return found._replace(decision=decision, tree=tree)
