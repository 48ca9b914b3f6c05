"""One systemd service as a manifest of kind Service."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from rorg.errors import advice
from rorg.manifest.programs import HOST
from rorg.manifest.yaml_text import Noted
from rorg.model.diagnostics import Diagnostic, Where
from rorg.model.units import format_duration
from rorg.tools.importing.manifests import NOTE, Made
from rorg.tools.importing.systemd_command import Line, shell_line, words_of
from rorg.tools.importing.systemd_unit import DECIMAL, Unit, number_of, seconds_of, with_specifiers

RUN = ("ExecStart", "ExecStartPre", "Environment", "EnvironmentFile", "WorkingDirectory", "User", "Group")
"""Keys whose values the program sees."""
TARGETS = ("multi-user.target", "graphical.target", "default.target")
RESTARTS = {"no": "never", "always": "always", "on-success": "always"}
"""Restart= -> restart; everything else becomes on-failure."""
LIMITS = {
    **{f"Limit{k.upper()}": k for k in ("core", "cpu", "data", "fsize", "memlock", "msgqueue", "nice", "nofile")},
    **{f"Limit{k.upper()}": k for k in ("nproc", "rss", "rtprio", "rttime", "sigpending", "stack")},
}
SILENT = {
    *("After", "Alias", "Before", "BindsTo", "Conflicts", "DefaultDependencies", "DefaultInstance", "Description"),
    *("Documentation", "ExecStart", "ExecStartPre", "RequiredBy", "Requires", "Requisite", "Restart", "Type"),
    *("WantedBy", "Wants"),
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


class ServiceOf:
    """Translates one unit."""

    def __init__(
        self, unit: Unit, units: Mapping[str, Unit], image: str, tree: Path, diagnostics: list[Diagnostic]
    ) -> None:
        self.unit, self.unknown = with_specifiers(unit)
        self.units, self.image, self.tree, self.found = units, image, tree, diagnostics
        self.spec: dict[str, Any] = {}
        self.container: dict[str, Any] = {}
        self.notes: list[str] = []

    def made(self) -> Made:
        """The manifest."""
        image = self.image or Noted(HOST, "rorg run --engine process runs the command directly on this machine")
        for key in (key for key in RUN if key in self.unknown):
            remedy = "their values"
            self.tell(key, f"specifiers such as {self.unknown[key]} are filled in only by systemd", remedy, "error")
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
            self.notes.append(message + advice(remedy))

    def _command(self) -> list[str]:
        """The command. A shell runs several commands, or one with variables."""
        starts = [Line.of(value) for value in self.unit.all("ExecStart")]
        before = [Line.of(value) for value in self.unit.all("ExecStartPre")]
        self._told_of_prefixes("ExecStart", starts)
        self._told_of_prefixes("ExecStartPre", before)
        if not starts:
            self.tell("Type", f"{self.unit.name} starts nothing", "ExecStart=", "error")
        if self.unit.last("Type") == "forking":
            self.tell(
                "Type", "Type=forking: rorg runs programs in the foreground", "the program's option for that", "error"
            )
        try:
            if len(starts) == 1 and not before and not starts[0].has_variables:
                return words_of(starts[0])
            line = shell_line(before, starts)
        except ValueError as error:
            self.tell("ExecStart", f"not a command line: {error}", "to close the quotes", "error")
            return []
        self.notes.append("A shell runs it, because it has variables or more than one command.")
        return ["sh", "-c", line]

    def _told_of_prefixes(self, key: str, lines: Iterable[Line]) -> None:
        """Notes what systemd does because of a prefix, and rorg does not."""
        for line in lines:
            if key == "ExecStart" and "-" in line.prefixes:
                self.tell(
                    key, f"{key}=-: for systemd, a failure of this program counts as success; rorg sees the failure"
                )
            if set("+!") & set(line.prefixes) and (user := self.unit.last("User")):
                self.tell(key, f"{key}=+: systemd runs this command as root; here, {user} runs it", "a task of its own")

    def _needs(self) -> None:
        for keys, field_ in ((("Requires", "BindsTo", "Requisite", "Wants"), "needs"), (("Conflicts",), "conflicts")):
            named = dict.fromkeys(self.unit.words(*keys))
            known = [self.units[n].name for n in named if n in self.units and n.endswith(".service")]
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

    def groups(self, _: str) -> None:
        """Groups beside that of the user."""
        self.container["group_add"] = list(dict.fromkeys(self.unit.words("SupplementaryGroups")))

    def group(self, value: str) -> None:
        """The group, which belongs to the user: it has no effect without one."""
        if "User" not in self.unit.settings:
            self.drop("Group", value, f"container: {{user: 'USER:{value}'}}")

    def cpus(self, _: str) -> None:
        """The CPUs that the service may run on."""
        parts = [part for value in self.unit.all("CPUAffinity") for part in re.split(r"[\s,]+", value)]
        if all(re.fullmatch(r"[0-9]{1,4}(-[0-9]{1,4})?", part) for part in parts):
            self.container["cpuset"] = ",".join(parts)
        else:
            self.drop("CPUAffinity", " ".join(parts), "container: {cpuset: 0-2}")

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
READ: Mapping[str, Callable[[ServiceOf, str], None]] = {
    "CPUAffinity": ServiceOf.cpus,
    "CPUQuota": ServiceOf.quota,
    "Environment": ServiceOf.environment,
    "EnvironmentFile": ServiceOf.environment_file,
    "Group": ServiceOf.group,
    "KillSignal": lambda service, value: service.container.update(stop_signal=value),
    "MemoryLimit": ServiceOf.memory,
    "MemoryMax": ServiceOf.memory,
    "SupplementaryGroups": ServiceOf.groups,
    "TasksMax": ServiceOf.tasks,
    "TimeoutSec": ServiceOf.time,
    "TimeoutStopSec": ServiceOf.time,
    "User": ServiceOf.user,
    "WorkingDirectory": lambda service, value: service.container.update(working_dir=value.removeprefix("-")),
}
