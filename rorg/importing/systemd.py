"""Imports systemd units: one Service for each service, one Group for each target."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rorg.importing.manifests import NOTE, Imported, Made
from rorg.importing.systemd_unit import DECIMAL, Unit, number_of, read_unit, seconds_of
from rorg.manifest.yaml_text import Noted
from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic, Where
from rorg.model.units import format_duration

HOST = "host"
"""The image of services that run as processes of this machine. The process engine ignores images."""
TARGETS = ("multi-user.target", "graphical.target", "default.target")
RESTARTS = {"no": "never", "always": "always", "on-success": "always"}
"""Restart= -> restart; everything else becomes on-failure."""
LIMITS = {
    **{f"Limit{k.upper()}": k for k in ("core", "cpu", "data", "fsize", "memlock", "msgqueue", "nice", "nofile")},
    **{f"Limit{k.upper()}": k for k in ("nproc", "rss", "rtprio", "rttime", "sigpending", "stack")},
}
SILENT = {
    *("After", "Alias", "Before", "BindsTo", "Conflicts", "DefaultDependencies", "Description", "Documentation"),
    *("ExecStart", "ExecStartPre", "Group", "RequiredBy", "Requires", "Requisite", "Restart", "Type", "WantedBy"),
    "Wants",
}
"""Handled elsewhere, or meaningless here: rorg starts needed services first anyway."""
REMEDIES = {
    "ExecStop": "container: {stop_signal: ...}",
    "ExecReload": "on_change: signal SIGHUP",
    "WatchdogSec": "a `live` probe",
    "PIDFile": "a command that stays in the foreground",
    "Nice": "container: {cpu_shares: ...}",
    "RestartSec": "to leave it out: delays grow automatically",
    "DeviceAllow": "container: {devices: [...]}",
}


def from_systemd(texts: Mapping[Path, str], image: str, tree: Path) -> Imported:
    """Imports units, given as path -> text. `image`: the image of the services; `tree`: directory of the manifests."""
    try:
        units = {unit.path.name: unit for unit in (read_unit(path, text) for path, text in texts.items())}
    except TooMuch as bound:
        return Imported(diagnostics=(bound.diagnostic,))
    made, found = list[Made](), list[Diagnostic]()
    for name, unit in units.items():
        if name.endswith(".target"):
            made += _group(unit, units, found)
        elif name.endswith(".service"):
            made.append(_Service(unit, units, image, tree, found).made())
        else:
            what = f"{name} is neither a service nor a target"
            found.append(Diagnostic(unit.where(), what, "the .service that it starts"))
    return Imported(tuple(made), diagnostics=tuple(sorted(found)))


def _group(unit: Unit, units: Mapping[str, Unit], found: list[Diagnostic]) -> list[Made]:
    """The group of the imported units that a target starts."""
    named = set(unit.words("Wants", "Requires", "BindsTo"))
    members = [u.name for n, u in units.items() if n.endswith(".service") and n in named]
    members += [
        u.name for u in units.values() if unit.path.name in u.words("WantedBy", "RequiredBy") and u.name not in members
    ]
    if not members:
        found.append(Diagnostic(unit.where(), f"no service of {unit.path.name} is imported with it", "", NOTE))
        return []
    return [
        Made("Group", unit.name, {"services": members}, (f"From {unit.path}.",), description=unit.last("Description"))
    ]


class _Service:
    """Translates one unit."""

    def __init__(self, unit: Unit, units: Mapping[str, Unit], image: str, tree: Path, found: list[Diagnostic]) -> None:
        self.unit, self.units, self.image, self.tree, self.found = unit, units, image, tree, found
        self.spec: dict[str, Any] = {}
        self.container: dict[str, Any] = {}
        self.notes: list[str] = []

    def made(self) -> Made:
        image = self.image or Noted(HOST, "rorg run --engine process runs the command directly on this machine")
        self.spec |= {"image": image, "command": self._command()}
        self._needs()
        self._when()
        for key in self.unit.settings:
            if key in READ:
                READ[key](self, self.unit.last(key))
            elif key in LIMITS:
                self._limit(LIMITS[key], self.unit.last(key))
            elif key not in SILENT:
                self.tell(key, f"{key} is not carried over", REMEDIES.get(key, ""))
        if self.container:
            self.spec["container"] = self.container
        comments = (f"From {self.unit.path}.", *self.notes)
        return Made("Service", self.unit.name, self.spec, comments, description=self.unit.last("Description"))

    def tell(self, key: str, message: str, remedy: str = "", severity: str = NOTE) -> None:
        """Adds a finding. A note also becomes a comment in the manifest."""
        self.found.append(Diagnostic(self.unit.where(key), message, remedy, severity))
        if severity != "error":
            self.notes.append(f"{message}{f'; {remedy}' if remedy else ''}")

    def _command(self) -> list[str]:
        """The command. A shell runs several commands, or one with variables."""
        starts = [_bare(value) for value in self.unit.all("ExecStart")]
        before = [_bare(value) for value in self.unit.all("ExecStartPre")]
        if not starts:
            self.tell("Type", f"{self.unit.name} starts nothing", "ExecStart=", "error")
        if self.unit.last("Type") == "forking":
            self.tell(
                "Type", "Type=forking: rorg runs programs in the foreground", "the program's option for that", "error"
            )
        text = " ".join([*before, *starts])
        if re.search(r"(?<!%)(%%)*%[a-zA-Z]", text):
            self.tell("ExecStart", "specifiers such as %i are filled in only by systemd", "their values", "error")
        if len(starts) == 1 and not before and "$" not in text:
            try:
                return shlex.split(starts[0].replace("%%", "%"))
            except ValueError as error:
                self.tell("ExecStart", f"not a command line: {error}", "to close the quotes", "error")
                return []
        self.notes.append("A shell runs it, because it has variables or more than one command.")
        lines = [*before, *starts[:-1], *(f"exec {start}" for start in starts[-1:])]
        return ["sh", "-c", " && ".join(lines).replace("%%", "%")]

    def _needs(self) -> None:
        for keys, field_ in ((("Requires", "BindsTo", "Requisite", "Wants"), "needs"), (("Conflicts",), "conflicts")):
            named = dict.fromkeys(self.unit.words(*keys))
            known = [n.removesuffix(".service") for n in named if n in self.units and n.endswith(".service")]
            if known:
                self.spec[field_] = known
            if others := [n for n in named if n not in self.units]:
                where = next(key for key in keys if others[0] in self.unit.words(key))
                self.tell(where, f"{', '.join(others)}: not imported, so not in {field_}")

    def _when(self) -> None:
        """Whether the service is always on, and whether it is restarted when it ends."""
        targets = [t for t in self.unit.words("WantedBy", "RequiredBy") if t in TARGETS]
        if targets:
            self.spec["always_on"] = Noted(True, f"WantedBy={targets[0]}")
        written = self.unit.last("Restart", "no")
        self.spec["restart"] = RESTARTS.get(written, "on-failure")
        if self.unit.last("Type") == "notify":
            self.tell("Type", "Type=notify: rorg asks the service whether it is ready", "a `ready` probe")

    def _limit(self, name: str, value: str) -> None:
        parts = [-1 if part == "infinity" else number_of(part) for part in value.split(":")]
        if None in parts or len(parts) > 2:
            self.drop(f"Limit{name.upper()}", value, "a number under container.ulimits")
            return
        self.container.setdefault("ulimits", {})[name] = (
            parts[0] if len(parts) == 1 else {"soft": parts[0], "hard": parts[-1]}
        )

    def environment(self, _: str) -> None:
        """All assignments; each word is one."""
        words: list[str] = []
        for value, line in self.unit.settings["Environment"]:
            try:
                words += shlex.split(value)
            except ValueError as error:
                where = Where(str(self.unit.path), line)
                self.found.append(Diagnostic(where, f"not assignments: {error}", "to close the quotes"))
        self.container["environment"] = dict(word.split("=", 1) for word in words if "=" in word)

    def environment_file(self, _: str) -> None:
        """All files; a leading dash makes a file optional."""
        files = self.unit.all("EnvironmentFile")
        self.container["env_file"] = [
            {"path": f.removeprefix("-"), "required": False} if f.startswith("-") else f for f in files
        ]

    def user(self, value: str) -> None:
        """The user, with the group if there is one."""
        group = self.unit.last("Group")
        self.container["user"] = f"{value}:{group}" if group else value

    def time(self, value: str) -> None:
        """The time that the service may take to stop."""
        seconds = seconds_of(value)
        if seconds:
            self.container["stop_grace_period"] = format_duration(seconds)
        else:
            key = next(k for k in ("TimeoutStopSec", "TimeoutSec") if k in self.unit.settings)
            self.drop(key, value, "container: {stop_grace_period: 10s}")

    def drop(self, key: str, value: str, remedy: str) -> None:
        """Notes a value that a manifest cannot express."""
        shown = value if len(value) <= 40 else f"{value[:40]}..."
        self.tell(key, f"{key}={shown} is not carried over", remedy)

    def memory(self, value: str) -> None:
        """A limit in bytes, or with a unit."""
        if re.fullmatch(r"[0-9]{1,9}[KMG]", value):
            self.container["mem_limit"] = f"{value}i"
        elif (number := number_of(value)) is not None:
            self.container["mem_limit"] = number
        elif value != "infinity":
            key = next(k for k in ("MemoryMax", "MemoryLimit") if k in self.unit.settings)
            self.drop(key, value, "container: {mem_limit: 512Mi}")

    def quota(self, value: str) -> None:
        """A limit in percent of one CPU."""
        if re.fullmatch(DECIMAL + "%", value) and 0 < float(value[:-1]) <= MOST_PERCENT:
            self.container["cpus"] = float(value[:-1]) / 100
        else:
            self.drop("CPUQuota", value, "container: {cpus: 1.5}")

    def tasks(self, value: str) -> None:
        """A limit of processes; `infinity` means no limit."""
        if number := number_of(value):
            self.container["pids_limit"] = number
        elif value != "infinity":
            self.drop("TasksMax", value, "container: {pids_limit: 100}")


MOST_PERCENT = 1e6
READ: Mapping[str, Callable[[_Service, str], None]] = {
    "CPUQuota": _Service.quota,
    "Environment": _Service.environment,
    "EnvironmentFile": _Service.environment_file,
    "KillSignal": lambda service, value: service.container.update(stop_signal=value),
    "MemoryLimit": _Service.memory,
    "MemoryMax": _Service.memory,
    "TasksMax": _Service.tasks,
    "TimeoutSec": _Service.time,
    "TimeoutStopSec": _Service.time,
    "User": _Service.user,
    "WorkingDirectory": lambda service, value: service.container.update(working_dir=value.removeprefix("-")),
}


def _bare(command: str) -> str:
    """The command without the prefixes that tell systemd how to run it."""
    return command.lstrip("-@:+!|").strip()
