"""The same world on a real Docker engine: its log is the engine's own stream of events.

Nothing of it can be copied, so each case makes what its scenario begins with anew. `python docker_world.py` plays
scenarios on a private engine, as __main__.py does on the sim engine.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import docker
from common import BASE_IMAGE, wait_for
from proof.acts import Acts
from proof.engine_link import EngineWorld
from proof.promises import STRANGER
from robots import WORK

from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE, LABEL_SPEC, Container

VERBS = {"create": "create", "start": "start", "die": "stop", "destroy": "remove", "pause": "pause"}
VERBS |= {"unpause": "resume", "rename": "rename", "exec_die": "exec"}
STATES = {"start": "running", "die": "exited", "pause": "paused", "unpause": "running"}
END = "rorg.io/proof"
"""A label of the container whose creation ends the log of a case."""
PLAYED = ("first-apply", "request", "release", "pause", "replacement", "failed-update", "removal", "rename", "crash")
PLAYED += ("spreading-restart", "manifest-put", "down")


class Recorder(threading.Thread):
    """Writes the events of the engine into a log, with the containers that there are after each."""

    def __init__(self, world: DockerWorld) -> None:
        super().__init__(daemon=True)
        self.world, self.engine, self.now = world, world.engine, dict(world.kept[0])
        self.stream = docker.APIClient(world.host, version="auto").events(decode=True, filters={"type": "container"})

    def run(self) -> None:
        with contextlib.suppress(Exception):  # the stream is closed
            for event in self.stream:
                self.note(event["Action"].partition(":")[0], event["id"], event["Actor"]["Attributes"], event)

    def note(self, action: str, id: str, about: Mapping[str, str], event: Mapping[str, Any]) -> None:
        id = STRANGER if id == self.world.stranger else id
        known = self.now.get(id)
        if action not in VERBS or (id != STRANGER and about.get(LABEL_OWNER) != self.world.owner):
            return
        if action == "create":
            made = Container(id, about["name"], about[LABEL_SERVICE], "created", digest=about[LABEL_SPEC])
            self.now[id] = made
        elif known is None:
            return
        elif action == "destroy":
            self.now.pop(id)
        elif action == "rename":
            self.now[id] = replace(known, name=about["name"])
        elif action in STATES:
            began = str(event["timeNano"]) if action == "start" else known.started_at
            code = int(about["exitCode"]) if action == "die" else None
            self.now[id] = replace(known, state=STATES[action], started_at=began, exit_code=code)
        service, text = (known or self.now[id]).service, about.get("exitCode", "")
        self.engine.log.add(VERBS[action], service, id, text, containers=dict(self.now))


class DockerWorld(Acts):
    """On the engine at `host`."""

    def __init__(self, folder: Path, host: str) -> None:
        super().__init__(folder)
        self.host, self.api = host, docker.APIClient(host, version="auto")
        self.given: Callable[[Any], Any] | None = None
        self.recorder: Recorder | None = None
        labels = {LABEL_OWNER: "another", LABEL_SERVICE: "base"}
        self.stranger = self.api.create_container(BASE_IMAGE, WORK, name=f"stranger-{os.getpid()}", labels=labels)["Id"]
        self.api.start(self.stranger)

    def environment(self, point: int, side: str) -> dict[str, str]:
        given = super().environment(point, side)
        return {**{k: v for k, v in given.items() if k != "PROOF_ENGINE"}, "DOCKER_HOST": self.host}

    def found(self) -> dict[str, Container]:
        rows = self.api.containers(all=True, filters={"label": f"{LABEL_OWNER}={self.owner}"})
        found = {STRANGER: Container(STRANGER, STRANGER, "", "running")}
        for row in rows:
            with contextlib.suppress(docker.errors.NotFound):
                found[row["Id"]] = self.inspected(row["Id"])
        return found

    def inspected(self, id: str) -> Container:
        about = self.api.inspect_container(id)
        state, labels = about["State"], about["Config"]["Labels"]
        began = "" if state["StartedAt"].startswith("0001") else state["StartedAt"]
        marks = {"service": labels[LABEL_SERVICE], "digest": labels[LABEL_SPEC]}
        code = state["ExitCode"] if state["Status"] == "exited" else None
        return Container(id, about["Name"][1:], state=state["Status"], started_at=began, exit_code=code, **marks)

    def prepare(self, given: Callable[[Any], Any]) -> None:
        self.given = given

    def restore(self) -> None:
        self.clear()
        self.specs, self.gone, self.asked = {}, set(), {}
        self.engine = EngineWorld(self.owner, {})
        assert self.given is not None
        super().prepare(self.given)
        self.engine = EngineWorld(self.owner, {})
        self.begin(self.kept[0])
        self.recorder = Recorder(self)
        self.recorder.start()

    def clear(self) -> None:
        self.kill()
        if self.recorder:
            self.recorder.stream.close()
        for row in self.api.containers(all=True, filters={"label": f"{LABEL_OWNER}={self.owner}"}):
            self.api.remove_container(row["Id"], force=True, v=True)

    def check_requests(self) -> None:
        """The engine's events come a little later than what they tell of."""
        super().check_requests()
        states = {id: c.state for id, c in self.found().items()}
        recorder = self.recorder
        if recorder:
            wait_for(lambda: {id: c.state for id, c in recorder.now.items()} == states, 10, "the engine's events")

    def end_program(self, container: Container) -> None:
        self.api.kill(container.id)

    def close(self) -> None:
        self.clear()
        self.api.remove_container(self.stranger, force=True)
        super().close()


def private() -> Any:
    """A private engine, started."""
    from dockerd import Dockerd, clean_up, import_base

    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    clean_up()
    folder = subprocess.check_output(["mktemp", "-d", "/tmp/rorg-dockerd.XXXXXX"], text=True).strip()
    engine = Dockerd(Path(folder))
    engine.start()
    import_base(engine.host)
    return engine


def main(names: list[str]) -> int:
    from proof import play

    engine = private()
    try:
        return play.main(names or list(PLAYED), partial(DockerWorld, host=engine.host))
    finally:
        engine.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
