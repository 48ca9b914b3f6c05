"""The actions that rorg would take: asked of the running rorg, or computed here if none answers for this tree."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import urlencode

from rorg_client import Error as ClientError

from rorg.cli.context import ROBOT, Context, bad_requests
from rorg.cli.output import note
from rorg.cli.terminal import hide, printable
from rorg.errors import Invalid, Unreachable, advice
from rorg.model.codes import CONFIRM
from rorg.model.units import counted

if TYPE_CHECKING:
    from rorg.daemon.commit_tree import CommitTree
    from rorg.daemon.tree import Tree


class Differences(NamedTuple):
    """The plan in all its forms, and where it comes from."""

    text: str
    """Step by step."""
    services: list[dict[str, Any]]
    """Service by service."""
    unified: dict[str, str]
    """With `unified`: the diff of each container that changes."""
    plan: dict[str, Any]
    empty: bool
    suspended: str
    """Why nothing of it is done now."""
    root: Path
    withheld: list[str]
    probed: list[str]
    """Services with a readiness probe."""
    fingerprint: str
    told: bool
    """By the running rorg, which follows this tree."""
    decision: Any = None
    """If it was computed here."""
    tree: Any = None
    """The same: the tree that was read."""
    commit: str = ""
    """Of the manifests, if they are from the history."""
    warnings: tuple[dict[str, Any], ...] = ()
    """Of these manifests, which can be used nevertheless."""

    @property
    def unconfirmed(self) -> list[str]:
        """Services whose change waits for a person, because it would end a driver in use."""
        return list(dict.fromkeys(w["service"] for w in self.plan["waitings"] if w.get("code") == CONFIRM))

    def overview(self) -> str:
        """One line for each service, and one with the counts."""
        lines = [*(s["line"] for s in self.services), self.plan["summary"]]
        return "".join(f"{line}\n" for line in lines if line)


def differences(context: Context, unified: bool = False, rev: str = "") -> Differences:
    """The actions that rorg would take for the tree as it is, or as it was at `rev` of its repository's history. Raises
    Invalid if the tree has errors, and Unreachable."""
    answer = _told(context, unified, rev)
    if answer is None:
        return _computed(context, unified, rev)
    if answer["errors"]:
        raise Invalid(
            f"use the manifests in {answer['root']}",
            counted(len(answer["errors"]), "error") + "\n" + "\n".join(line(d) for d in answer["errors"]) + "\n",
            "to fix them, then `rorg validate`",
        )
    if answer["requests_errors"]:
        raise bad_requests(context.state.requests, answer["requests_errors"][0])
    return _of(answer, Path(answer["root"]), told=True)


def _of(answer: dict[str, Any], root: Path, told: bool) -> Differences:
    forms = {name: answer[name] for name in ("text", "services", "unified", "plan", "empty", "suspended")}
    return Differences(
        **forms,
        root=root,
        withheld=answer["withheld"],
        probed=answer["probed"],
        fingerprint=answer["fingerprint"],
        told=told,
        commit=answer.get("commit", ""),
        warnings=tuple(answer.get("warnings", ())),
    )


def warn_of_other_tree(context: Context, comparison: Differences) -> None:
    """Notes if the compared manifests may not be the ones that the user thinks of."""
    here = Path("manifests")
    if comparison.told:
        if not (context.remote or context.directory) and os.path.isdir(here) and here.resolve() != comparison.root:
            note(f"the running rorg follows {comparison.root}; {here.resolve()} is not looked at")
        return
    last = ((context.last() or {}).get("tree") or {}).get("root")
    if isinstance(last, str) and Path(last) != comparison.root.resolve():
        runs = "the running rorg follows" if context.state.owner() else "rorg followed"
        note(f"{runs} {last}; this compares {comparison.root.resolve()}")


def _told(context: Context, unified: bool, rev: str) -> dict[str, Any] | None:
    """The answer of the running rorg; None if it says nothing about this tree."""
    if context.directory and context.place.elsewhere:
        context.here("compare that directory")
    client, asked = context.client(), {"unified": "true" if unified else "", "rev": rev}
    query = urlencode({name: value for name, value in asked.items() if value})
    try:
        answer: dict[str, Any] | None = client.call("GET", f"/v1/diff{'?' * bool(query)}{query}") if client else None
    except ClientError:
        if context.remote or context.silence:
            raise
        return None  # an older rorg, or one that this user may not ask: computing it here reports what is wrong
    if answer and context.directory and Path(answer["root"]) != context.directory.resolve():
        context.here("compare that directory")
        return None
    # An older rorg may ignore what was asked.
    same = (
        answer and bool(answer.get("commit")) == bool(rev) and os.environ.get(ROBOT) in (None, "", answer.get("robot"))
    )
    return answer if answer and same and "services" in answer else None


def line(error: dict[str, Any]) -> str:
    """One mistake in a tree, as the API reports it."""
    code = f" [{error['code']}]" if error.get("code") else ""
    place = f"{error['file']}:{error['line']}:{error['column']}"
    return printable(f"{place}: {error['severity']}: {error['message']}{advice(error['remedy'])}{code}")


def tree_of(context: Context) -> Tree:
    """The tree that a command is about, not read yet. Raises Invalid if there is no such directory."""
    from rorg.daemon.wiring import make_tree

    if context.directory and not os.path.isdir(context.directory):
        what = f"read manifests in {context.directory}"
        raise Invalid(what, "no such directory", "the directory that holds services/")
    tree = make_tree(context.root, context.state, context.engine_name, context.robot)
    hide(tree.masker)
    return tree


def past_of(context: Context, tree: Tree, rev: str) -> CommitTree:
    """A state of the tree from the history: by its number there, or as git names it."""
    from rorg.daemon.commit_tree import load_at
    from rorg.history.database import reading
    from rorg.history.revisions import NUMBER, Revisions, for_git

    if NUMBER.fullmatch(rev):
        with suppress(Unreachable), reading(context.state.journal) as database:
            rev = for_git(rev, Revisions(database))
    return load_at(tree, rev)


def _computed(context: Context, unified: bool, rev: str) -> Differences:
    from rorg.api.views import plan_forms
    from rorg.cli.local import decision_for
    from rorg.manifest.load import unusable
    from rorg.store.last_good import read_kept

    tree, before = tree_of(context), read_kept(context.state.path).catalog
    if rev:
        past = past_of(context, tree, rev)
        decision = decision_for(context, past.desired)
        forms = {**plan_forms(decision, decision.plan, unified, before), "commit": past.commit}
        return _of(forms, context.root, told=False)
    tree.read_now()
    if not tree.loaded:
        raise unusable(context.root, tree.errors)
    decision = decision_for(context, tree.desired)
    comparison = _of(plan_forms(decision, decision.plan, unified, before), context.root, told=False)
    return comparison._replace(decision=decision, tree=tree, warnings=tuple(d.as_json() for d in tree.warnings))
