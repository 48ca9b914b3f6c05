"""Sample lines of every command, for the tests that try all commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

from rorg.cli.app import RORG, typer_command


@dataclass(frozen=True)
class Line:
    """A line of a command, and whether it names the engine, or rorg, if that does not answer. Other lines just end."""

    words: str
    engine: bool = False
    rorg: bool = False


@dataclass(frozen=True)
class Sample:
    """The lines of a command."""

    member: Sequence[str]
    """Those of a member of rorg's group who is not its user."""
    hang: Line
    """One that must end although the engine, or rorg, does not answer."""
    forms: Mapping[str, tuple[list[str], dict[str, object] | None]] = field(default_factory=dict)
    """Line -> what -o name prints, and some of what -o json says of the first thing."""
    alike: Sequence[str] = ()
    """Those that do the same with a running rorg and without one."""


def values(name: str, words: list[str], environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """What a line means: the value of each parameter. Nothing is done. Raises UsageError."""
    with patch.dict("os.environ", environment or {}):
        root = RORG.make_context("rorg", [])
        return typer_command(name).make_context(name, list(words), parent=root).params


LONG = "x" * 65
BOTH = {"engine": True, "rorg": True}
SAMPLES = {
    "init": Sample(["init robot"], Line("init {new}/robot")),
    "certificate": Sample(["certificate --person ada --into keys"], Line("certificate --person ada --into {new}/keys")),
    "import": Sample(
        ["import roslaunch nosuch.launch"], Line("import systemd {unit} --image debian --output {new}/imported")
    ),
    "validate": Sample(
        ["validate", "validate robot --engine process"], Line("validate {tree}"), {"validate": ([], None)}
    ),
    "doctor": Sample(["doctor --engine process", "doctor -o json --engine process"], Line("doctor", **BOTH)),
    "diff": Sample(
        ["diff", "diff -o json", "diff {tree}"], Line("diff", **BOTH), {"diff": ([], {"actions": [], "waitings": list})}
    ),
    "apply": Sample(
        ["apply --yes --wait", "apply {tree} --yes"],
        Line("apply --yes", **BOTH),
        {"apply --yes": ([], {"actions": [], "waitings": list})},
    ),
    "run": Sample(["run nowhere"], Line("run {tree}")),
    "get": Sample(
        ["get", "get services navigation", "get groups -o json", "get images", "get requests -o yaml"],
        Line("get", **BOTH),
        alike=[
            "get requests",
            "get requests -o json",
            "get requests tour -o yaml",
            "get requests nosuch",
            "get groups -o json",
            "get groups nosuch",
            "get images",
            "get services",
            "get services -o name",
            "get gripper arm -o json",
            "get driving mapper --sort-by priority",
            "get --group driving -l nothing=here",
            "get navigatoin",
            "get --sort-by size",
            "get policies -o json",
            "get profiles nosuch",
            "get services nosuch",
            "get service driving",
            "get neither",
        ],
    ),
    "describe": Sample(
        ["describe base"],
        Line("describe arm", **BOTH),
        alike=["describe service gripper", "describe nosuch"],
    ),
    "why": Sample(
        ["why navigation", "why driving -o json"],
        Line("why arm", **BOTH),
        {"why base": (["base"], {"service": "base", "wanted": True})},
        alike=[
            "why navigation",
            "why navigation -o json",
            "why roscore",
            "why driving -o yaml",
            "why gripper",
            "why stub",
            "why developer",
            "why nosuch",
            "why ''",
        ],
    ),
    "explain": Sample(["explain service.spec.idle"], Line("explain service.needs")),
    "request": Sample(
        ["request navigation --id tour --wait", "request driving --id drive --ttl 10m"],
        Line("request arm --id more", **BOTH),
        {"request driving --id tour --ttl 90": (["tour"], {"ttl": 90.0, "services": ["driving"]})},
        alike=[
            "request navigation",
            "request navigation roscore navigation --id tour --reason visitor --priority 70",
            "request driving --id tour",
            "request roscore --id other --ttl 10s",
            "request roscore --id other --ttl 1500ms",
            "request roscore --ttl 0s",
            "request roscore --ttl soon",
            "request roscore --ttl 9999999d",
            "request roscore --priority 101",
            "request",
            "request navigatoin",
            "request navigation nosuch driving neither",
            "request ''",
            f"request {LONG}",
            "request nav/igation",
            "request driving --id 'bad id'",
            f"request driving --id {LONG}",
            f"request roscore --reason {'y' * 501}",
            "request roscore --as mission",
            "request roscore --as gripper",
            "request roscore --as stub",
            "request roscore --as nobody",
            "request roscore --as driving",
            f"request roscore --as {LONG}",
            "request gripper arm",
            "request mapper",
            "request mapper --id navigation",
            "request mapper --id tour",
            "request big",
            "request big nosuch",
        ],
    ),
    "release": Sample(
        ["release drive --yes"],
        Line("release none", **BOTH),
        {"release tour": (["tour"], {"id": "tour", "requester": "developer"})},
        alike=[
            "release tour",
            "release nosuch",
            "release shared",
            "release shared --as mission",
            "release shared --as nobody",
            "release always",
            "release 'bad id'",
        ],
    ),
    "run-with": Sample(["run-with navigation -- true"], Line("run-with arm --timeout 1s -- true", **BOTH)),
    "restart": Sample(
        ["restart base --yes --wait"],
        Line("restart arm --yes", **BOTH),
        {"restart base": (["base"], {"service": "base"})},
        alike=[
            "restart navigation",
            "restart driving",
            "restart mission",
            "restart arm",
            "restart arm --yes",
            "restart gripper",
            "restart developer",
            "restart stub --yes",
            "restart nothing-real",
            "restart nosuch",
            "restart na/vigation",
            "restart ''",
        ],
    ),
    "retry": Sample(
        ["retry base", "retry base --yes"],
        Line("retry arm --yes", **BOTH),
        alike=["retry navigation", "retry navigation arm", "retry developer", "retry nosuch", "retry ''"],
    ),
    "take": Sample(["take base --yes", "take nosuch --yes"], Line("take arm --yes", rorg=True)),
    "hold": Sample(
        ["hold navigation --for 10m", "hold navigation --end"],
        Line("hold lidar --for 1s --yes", **BOTH),
        {"hold spare --for 1m30s": (["spare"], {"seconds": 90.0, "held": True})},
        alike=[
            "hold navigation --for 10m --reason why-not",
            "hold driving gripper navigation --for 1h30m",
            "hold gripper nosuch --for 10m",
            "hold gripper developer --for 10m",
            "hold nothing-real --for 10m",
            "hold navigation",
            "hold navigation --for 0s",
            "hold navigation --for 300.3ms",
            f"hold navigation --for 10m --reason {'y' * 501}",
            "hold mapper --end",
            "hold mapper gripper --end",
            "hold nosuch --end",
            "hold ''  --for 10m",
        ],
    ),
    "suspend": Sample(
        ["suspend --for 10m --reason lunch", "suspend --end"],
        Line("suspend --for 1s", **BOTH),
        {"suspend --for 10": (["rorg"], {"seconds": 10.0, "suspended": True})},
        alike=[
            "suspend --for 10m --reason maintenance",
            "suspend",
            "suspend --for 0s",
            "suspend --for 20y",
            f"suspend --for 10m --reason {'y' * 501}",
            "suspend --end",
        ],
    ),
    "wait": Sample(
        ["wait base"],
        Line("wait arm --timeout 1s", **BOTH),
        {"wait base --timeout 20s": (["base"], {"ready": True})},
        alike=["wait", "wait navigation --timeout soon"],
    ),
    "events": Sample(
        ["events", "events -o json --tail 3", "events --service base --since 1h"],
        Line("events", rorg=True),
        alike=["events --until 2020-01-01"],
    ),
    "history": Sample(
        ["history", "history show 1", "history diff 1", "history export --format protobuf --file all.pb"],
        Line("history", rorg=True),
        alike=[
            "history show 1",
            "history show 1 -o json",
            "history show nosuch",
            "history diff 1 1",
            "history diff 1 99",
            "history -n 1 -o yaml",
        ],
    ),
    "ui": Sample(["ui --no-browser --port 99999"], Line("ui --no-browser --port 99999")),
    "fleet": Sample(["fleet status nosuch.yaml"], Line("fleet status {new}/nosuch.yaml")),
    "rollback": Sample(["rollback --print"], Line("rollback --yes")),
    "restore": Sample(["restore --at 10m"], Line("restore 2026-01-01T00:00:00Z --yes")),
    "timeline": Sample(
        ["timeline base", "timeline base -o json --since 10m"],
        Line("timeline arm", rorg=True),
        alike=["timeline nosuch"],
    ),
    "trace": Sample(
        ["trace record --file today.yaml", "trace show today.yaml", "trace generate --duration 10m"],
        Line("trace record", rorg=True),
    ),
    "top": Sample(
        ["top --once", "top -o json"],
        Line("top --once", **BOTH),
        {"top": (["base", "spare"], {"services": list, "machine": dict, "pressure": dict})},
    ),
    "logs": Sample(["logs base"], Line("logs arm", **BOTH)),
    "exec": Sample(["exec base -- true"], Line("exec arm -- true", engine=True)),
    "shell": Sample(["shell base"], Line("shell arm", engine=True)),
    "cp": Sample(["cp base:/etc/hostname ."], Line("cp arm:/etc/passwd {new}/passwd", engine=True)),
    "graph": Sample(
        ["graph", "graph -o dot", "graph images -o json"],
        Line("graph", rorg=True),
        {"graph": (["base", "developer", "navigation", "roscore", "spare"], {"services": list})},
    ),
    "simulate": Sample(["simulate nosuch.yaml robot"], Line("simulate {trace} {tree}")),
    "edit": Sample(["edit base"], Line("edit service/arm")),
    "fit": Sample(["fit base", "fit -o json --since 1h"], Line("fit arm", rorg=True)),
    "plot": Sample(["plot usage -o usage.gif"], Line("plot graph -o {new}/graph.svg", rorg=True)),
    "build": Sample(["build --manifests robot --engine process"], Line("build", engine=True)),
    "image": Sample(["image list"], Line("image list", engine=True)),
    "export": Sample(["export compose robot"], Line("export compose {tree}")),
    "dev": Sample(["dev base", "dev"], Line("dev", engine=True)),
    "demo": Sample(["demo --help"], Line("demo --engine docker", engine=True)),
    "emulate": Sample(["emulate nosuch.yaml"], Line("emulate {trace} {tree} --engine docker", engine=True)),
    "schema": Sample(["schema schemas"], Line("schema Service")),
    "help": Sample(["help get", "help options"], Line("help get")),
    "completion": Sample(["completion bash"], Line("completion bash")),
    "down": Sample(["down --yes"], Line("down --yes", **BOTH)),
}
"""By the name of the command; `down` comes last, as it ends the robot."""
