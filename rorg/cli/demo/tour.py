"""The course of the demo: the five actions of the work cycle, three commits, and a comparison."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from rorg.cli.demo.robot import DemoRobot
from rorg.cli.demo.show import Bar, Show
from rorg.errors import advice
from rorg.model.units import format_memory

FACE = ["ros_face_train_controller", "snowboy"]
CYCLE: list[tuple[str, list[str]]] = [
    ("2 standby: look for visitors", FACE),
    ("3 chat: talk with one", [*FACE, "gcloud_speech_action_server", "ros_speak_text"]),
    ("4 tour: drive ahead", ["navigation_route", "ros_speak_text"]),
    ("4 tour: look whether the visitor follows", ["navigation_route", "ros_speak_text", "leg_tracker"]),
    ("5 return: drive back", ["navigation_route"]),
]
"""Actions 2 to 5 of the paper's figure 4, as `behavioral` requests them; their needs follow."""
PICTURED = {CYCLE[0][0]: "Standby: looking for visitors", CYCLE[3][0]: "Tour: driving, talking, looking back"}
"""The two moments of the picture."""
DWELL = 3.0
"""Seconds that each step is shown and measured."""


def play(robot: DemoRobot, show: Show) -> None:
    """Plays the demo from begin to end."""
    show.step("Setting up: a git repository with 41 services, and their images")
    catalog = robot.set_up()
    began = time.monotonic()
    robot.build(catalog, show.progress)
    show.line(
        f"images are there after {time.monotonic() - began:.0f} s; stand-ins use {robot.scale:.0%} of what they declare"
    )
    robot.start()
    robot.wait("the start", lambda v: len(v["services"]) == 42)
    robot.settle("the start")
    show.line(f"rorg runs: {len(robot.active())} of 41 services are always on, the rest is not wanted")
    figures = _cycle(robot, show)
    _commits(robot, show)
    _compare(robot, show, figures)


def _cycle(robot: DemoRobot, show: Show) -> list[tuple[float, float]]:
    figures = []
    before = robot.active()
    robot.request("autonomy", "developer", ["behavioral"])
    for name, services in [("1 start: the developer requests behavioral", []), *CYCLE]:
        show.step(f"Action {name}")
        if services:
            robot.request("action", "behavioral", services)
        began = time.monotonic()
        view = robot.settle(name)
        _changes(show, view, before, robot.active(), time.monotonic() - began)
        before = robot.active()
        figures.append(_measure(robot, show))
        if name in PICTURED:
            show.remember(PICTURED[name], robot)
    show.step("Back to action 2: the tour is over")
    robot.request("action", "behavioral", CYCLE[0][1])
    view = robot.settle("standby")
    _changes(show, view, before, robot.active(), 0)
    gone = view["services"]["cartographer_localization"]
    show.line(
        f"cartographer_localization: {gone['state']}. Nobody ever requested it: navigation needs it, so it was "
        "started before navigation and ceased after it"
    )
    return figures


def _changes(show: Show, view: Mapping[str, Any], before: set[str], after: set[str], seconds: float) -> None:
    for name in sorted(after - before):
        show.line(f"  > {name:<28} {view['services'][name]['why']}")
    for name in sorted(before - after):
        show.line(f"  # {name:<28} {view['services'][name]['state']}: no longer wanted")
    show.line(f"  {len(after)} services are active" + (f", ready after {seconds:.1f} s" if seconds else ""))


def _measure(robot: DemoRobot, show: Show) -> tuple[float, float]:
    """(cores, bytes) of all services during one action."""
    first, began = robot.usage(), time.monotonic()
    show.pause(robot, DWELL)
    last, seconds = robot.usage(), time.monotonic() - began
    cpu = sum(max(0.0, u.cpu - first[n].cpu) for n, u in last.items() if n in first) / seconds
    memory = sum(u.memory for u in last.values())
    show.line(f"  measured: {cpu:.2f} cores, {format_memory(memory)}")
    return cpu, memory


def _ids(view: Mapping[str, Any]) -> dict[str, str]:
    return {n: s["incarnation"] for n, s in view["services"].items() if s["incarnation"]}


def _commits(robot: DemoRobot, show: Show) -> None:
    manifest = robot.tree / "services" / "ros_trigger_ui.yaml"
    good, view = manifest.read_text(), robot.settle("the start")
    runs, fingerprint = _ids(view), view["tree"]["fingerprint"]

    show.step("A commit with a mistake")
    manifest.write_text(good.replace("  image:", "  imagge:"))
    commit = robot.commit("a typo")
    view = robot.wait("the refusal", lambda v: bool(v["tree"]["errors"]))
    for error in view["tree"]["errors"]:
        show.line(
            f"  {commit}: {error['file'].replace(str(robot.folder), '')[1:]}:{error['line']}:{error['column']}: "
            f"{error['message']}{advice(error['remedy'])}"
        )
    same = _ids(view) == runs
    show.line(f"  refused; the robot keeps running: {len(runs)} services, " + ("all untouched" if same else "CHANGED"))
    robot.git("revert", "--no-edit", "HEAD")
    robot.wait("the revert", lambda v: not v["tree"]["errors"])

    show.step("A good commit")
    manifest.write_text(good + "  container:\n    environment: {BUTTONS: large}\n")
    commit = robot.commit("larger buttons")
    robot.wait("the change", lambda v: v["tree"]["fingerprint"] != fingerprint and not v["tree"]["errors"])
    view = robot.settle("the change")
    changed = sorted(n for n, run in _ids(view).items() if runs.get(n) != run)
    show.line(
        f"  {commit}: replaced {', '.join(changed)}, and nothing else"
        if changed == ["ros_trigger_ui"]
        else f"  {commit}: REPLACED {changed}"
    )

    show.step("git revert")
    robot.git("revert", "--no-edit", "HEAD")
    robot.wait("the revert", lambda v: v["tree"]["fingerprint"] == fingerprint)
    view = robot.settle("the revert")
    changed = sorted(n for n, run in _ids(view).items() if runs.get(n) != run)
    show.line(f"  back to what was declared before, replaced: {', '.join(changed)}")


def _compare(robot: DemoRobot, show: Show, figures: list[tuple[float, float]]) -> None:
    states = [s["state"] for s in robot.view()["services"].values() if not s["wanted"]]
    paused, stopped = states.count("paused"), states.count("exited")
    show.step("Everything on, as robots do without rorg")
    robot.request("everything", "developer", ["everything"])
    robot.settle("everything")
    show.line(f"  {len(robot.active())} services are active")
    all_cpu, all_memory = _measure(robot, show)
    cpu = sum(f[0] for f in figures) / len(figures)
    memory = sum(f[1] for f in figures) / len(figures)
    robot.release("everything", "developer")
    show.close()
    show.step("Summary (measured now, with stand-ins whose weights are synthetic)")
    for what, one, other, form in (
        ("CPU", all_cpu, cpu, lambda v: f"{v:.2f} cores"),
        ("memory", all_memory, memory, format_memory),
    ):
        show.line(f"  {what:<7} everything on {form(one):>10}  {'█' * 40}")
        show.line(f"  {'':<7} on demand     {form(other):>10}  {'█' * round(40 * other / one)} {other / one - 1:+.0%}")
    mib = 1 << 20
    show.save([Bar("CPU", all_cpu, cpu, "{:.2f} cores"), Bar("memory", all_memory / mib, memory / mib, "{:.0f} MiB")])
    show.line(
        f"  idle    {paused} paused (what starts slowly: back in milliseconds, but keeps its memory), "
        f"{stopped} stopped (everything else)"
    )
