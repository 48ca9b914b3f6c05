"""Commits a return to an earlier state of the manifests, for `rorg rollback` and `restore`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Protocol

from rorg.cli.apply import bring_about, taken
from rorg.cli.context import Context
from rorg.cli.differences import Differences, differences
from rorg.cli.goals import Goal
from rorg.cli.output import note
from rorg.errors import Refused
from rorg.host.contents import mounted
from rorg.host.git_edit import SHORT, Restoring, changed, top_of, unknown
from rorg.host.git_process import git_command
from rorg.model.catalog import Catalog
from rorg.model.codes import CONFIRM

NAMED = 10
"""Files that an error names."""


class Agreed(Protocol):
    """Shows the plan and its owner, and asks, unless that is empty and there is `nothing` else to agree to. Raises
    Refused."""

    def __call__(self, owner: dict[str, Any] | None, shown: Differences, *, nothing: bool) -> None: ...


def restoring(root: Path, robot: str, goal: Goal, service: str) -> Restoring:
    """The commit that would return the manifests directory and the sources of its images, or of one service the
    manifest, its part of this robot's overlay, and the files of the tree that it mounts. Raises Refused, also if these
    have uncommitted changes, and Invalid if the earlier manifests have errors."""
    from rorg.manifest.load import load

    top = top_of(root)
    past, now = past_manifests(root, robot, goal), load(root, robot=robot).catalog
    if service:
        files = _manifest(root, past, service, goal)
        overlay = [root / "robots" / robot / os.path.relpath(path, root) for path in files if robot]
        mounts = _own_mounts(top, root, [past, *([now] if now else [])], service, goal)
        places, of = [*files, *overlay, *mounts], f" {service}"
    else:
        places, of = [root, *_contexts(past), *(_contexts(now) if now else [])], ""
    paths = _below(top, places)
    _refuse_to_lose(top, changed(top, *paths) if paths else [])
    return Restoring(top, goal.commit, paths, f"Roll back{of} to {goal.title}")


def past_manifests(root: Path, robot: str, goal: Goal) -> Catalog:
    """The earlier manifests. Raises Invalid if they have errors."""
    from rorg.daemon.commit_tree import load_at
    from rorg.daemon.tree import Tree

    return load_at(Tree(root, host=robot), goal.commit).catalog


def _manifest(root: Path, past: Catalog, service: str, goal: Goal) -> list[Path]:
    """The files that declared it then and declare it now."""
    from rorg.api.manifest_texts import manifests_of

    if service not in past.services or not past.services[service].where.file:
        why = f"it was not declared in {goal.title}"
        raise Refused(f"roll {service} back", why, "`rorg rollback REV` for all services")
    manifests = manifests_of(root)
    now, file = manifests.get(("Service", service)), past.services[service].where.file
    others = [s.where.file for s in past.services.values() if s.name != service]
    others += [group.where.file for group in past.groups.values()]
    if file in others or (now and now.text != now.content):
        why = "its file declares other manifests too, which would go back with it"
        raise Refused(f"roll {service} back", why, "`rorg rollback REV` for all services")
    return [root / file, *([now.path] if now else [])]


def _own_mounts(top: Path, root: Path, catalogs: Iterable[Catalog], service: str, goal: Goal) -> set[Path]:
    """The places of the tree that it mounts in these catalogs and that change it. Raises Refused if one of them would
    change for another service too."""
    mine, others = set[Path](), dict[Path, str]()
    for name, one in (item for catalog in catalogs for item in catalog.services.items() if item[1].spec is not None):
        places = [Path(place) for place in mounted(one.spec or {}, str(root))]
        if name != service:
            others |= dict.fromkeys(places, name)
        elif one.on_change != "none":
            mine |= {*places}
    for place, name in sorted(others.items()):
        shared = [p for p in mine if p.is_relative_to(place) or place.is_relative_to(p)]
        if shared and Restoring(top, goal.commit, _below(top, shared), "").differs():
            why = f"{name} mounts {os.path.relpath(place, root)} too, which would go back with it"
            raise Refused(f"roll {service} back", why, "`rorg rollback REV` for all services")
    return mine


def _contexts(catalog: Catalog) -> list[Path]:
    return [Path(image.context) for image in catalog.images.values() if image.context]


def _below(top: Path, places: Iterable[Path]) -> tuple[str, ...]:
    """The places inside the repository, without those inside another of them."""
    roots: list[Path] = []
    for place in sorted({Path(os.path.realpath(p)) for p in places}):
        if place.is_relative_to(top) and not any(place.is_relative_to(other) for other in roots):
            roots.append(place)
    return tuple(str(place.relative_to(top)) for place in roots)


def all_committed(root: Path, robot: str) -> None:
    """Raises Refused if a file of the manifests directory has uncommitted changes, or a manifest is unknown to git."""
    from rorg.manifest.documents import tree_files

    top = top_of(root)
    manifests = [os.path.relpath(path, top) for path in tree_files(root, robot)]
    _refuse_to_lose(top, [*changed(top, root), *unknown(top, manifests)])


def _refuse_to_lose(top: Path, files: list[str]) -> None:
    """Raises Refused if there are files that are not committed."""
    if files:
        remedy = f"`{git_command(top, 'stash', '--include-untracked')}`, or a commit of them"
        raise Refused("go back", f"not committed: {_listed(files)}", remedy)


def _listed(files: list[str]) -> str:
    return ", ".join(files[:NAMED]) + (f" and {len(files) - NAMED} more" if len(files) > NAMED else "")


def go_back(
    context: Context,
    root: Path,
    wanted: Restoring,
    agreed: Agreed,
    *,
    command: str,
    doubt: str = "",
    waiting: tuple[str | None, float],
    then: Callable[[], None] = lambda: None,
) -> bool:
    """Shows the plan, the files that change and the `doubt` about the goal, and asks (`agreed`). Then commits, calls
    `then`, and carries it out. `waiting`: what to wait for (READY, PROVEN or None), and for how many seconds. False if
    there was nothing to commit. Raises Refused and NotReady."""
    from rorg.host.person import caller

    if is_copy(context, root):
        note("\n".join(wanted.commands(clone=True)))
        raise Refused("commit here", "rorg follows another repository", "these commands in a clone of that")
    owner = taken(context, command)
    made = wanted.commit(caller(os.environ, os.getuid(), os.getgid()), os.environ)
    shown = differences(context, rev=made) if made else differences(context)
    if made:
        note(f"files that change: {_listed(wanted.files(made))}")
    if doubt:
        note(f"caution: {doubt}")
    agreed(owner, shown, nothing=not made)
    if made:
        wanted.take(made)
        note(f"committed {made[:SHORT]}: {wanted.message}")
    differences(context)  # until rorg has read it
    then()
    comparison = differences(context)
    # What waits for a person but was not shown goes on waiting.
    withheld = [n for n in comparison.withheld if n in shown.withheld]
    waitings = [w for w in comparison.plan["waitings"] if w.get("code") != CONFIRM or w["service"] in shown.unconfirmed]
    agreed_to = comparison._replace(withheld=withheld, plan={**comparison.plan, "waitings": waitings})
    wait, timeout = waiting
    bring_about(context, owner, agreed_to, wait, timeout)
    return bool(made)


def is_copy(context: Context, root: Path) -> bool:
    """Whether a directory of manifests is the copy of a repository that a running rorg has fetched."""
    return root.is_relative_to(context.state.git.resolve())


def tree_of(context: Context) -> Path:
    """The directory of manifests: that of the running rorg, even if only its socket is known. Raises Refused outside of
    a repository."""
    if context.place.elsewhere:
        context.here("commit in its tree")
    view = context.live() if context.remote and not context.directory else None
    root = (Path(view["tree"]["root"]) if view else context.root).resolve()
    top_of(root)
    return root
