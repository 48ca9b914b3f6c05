"""Scenes in which the manifests change: a commit with a mistake, an update that fails, and their reverts."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from rorg.cli.demo.stage import Stage
from rorg.errors import advice

UPDATED = "ros_trigger_ui"
BAD = """  update: {bake: 30s}
  container:
    environment: {BUTTONS: large, STANDIN_CRASH_AFTER: "0.2"}
"""
"""A change after which the program crashes soon. On a busy machine even that may take longer than the default bake."""
REVERT = "git revert --no-edit HEAD"


def typing_mistake(stage: Stage) -> None:
    """A commit with an invalid manifest changes nothing."""
    stage.show.scene("Two bad commits: a typing mistake, and a program that crashes")
    _commit(stage, "A new image", lambda text: text.replace("  image:", "  imagge:"))
    view = stage.robot.wait("the refusal", lambda v: bool(v["tree"]["errors"]))
    stage.print_actions()
    for error in view["tree"]["errors"]:
        place = error["file"].replace(f"{stage.robot.repository}/", "")
        text = f"{error['message']}{advice(error['remedy'])}"
        stage.show.line(f"{place}:{error['line']}:{error['column']}: {text}")
    stage.run(REVERT)
    stage.robot.wait("the revert", lambda v: not v["tree"]["errors"])
    stage.settle("the revert")
    stage.show.line(f"the commit was refused; {stage.others()}")


def bad_update(stage: Stage) -> None:
    """An update whose program crashes is undone, and `git revert` then has nothing to restart."""
    began = time.monotonic()
    _commit(stage, "Larger buttons", lambda text: text + BAD)
    view = stage.robot.wait("the end of the update", _undone)
    stage.look_at(view)
    seconds = time.monotonic() - began
    why = _updated(view)["message"].partition(";")[0]
    stage.show.line(f"undone after {seconds:.1f} s, because it {why}; {stage.others(UPDATED)}")
    stage.run(REVERT)
    stage.robot.wait("the revert", lambda v: _updated(v)["reason"] != "Quarantined")
    stage.settle("the revert")
    stage.show.line(f"{UPDATED} is as declared; {stage.others()}")


def _commit(stage: Stage, message: str, edit: Callable[[str], str]) -> None:
    """Edit the manifest, and commit it."""
    manifest = stage.robot.tree / "services" / f"{UPDATED}.yaml"
    manifest.write_text(edit(manifest.read_text()))
    stage.run(f"git commit --quiet --all --message '{message}'")


def _updated(view: Mapping[str, Any]) -> Mapping[str, Any]:
    """The condition that says what came of the last update; without a reason if there is nothing to say."""
    conditions = view["services"].get(UPDATED, {}).get("conditions", ())
    return next((c for c in conditions if c["type"] == "Updated"), {"reason": "", "message": ""})


def _undone(view: Mapping[str, Any]) -> bool:
    """Whether the update has failed, and the previous container is ready again."""
    at_rest = not (view["plan"]["actions"] or view["in_flight"])
    return at_rest and _updated(view)["reason"] == "Quarantined" and view["services"][UPDATED]["health"] == "Healthy"
