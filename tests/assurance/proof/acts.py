"""What people and programs do to a robot. Each may be done again after a kill, and then does nothing twice."""

from __future__ import annotations

import contextlib
import os
import signal
from typing import Any

import commands
from common import wait_for
from proof.world import PATIENCE, PROGRAM, Died, Prepared, World, outcomes_of
from robots import write_tree

from rorg.client import Error, NotFound, Refused
from rorg.core.observed import Container

ALONE = ("export", "import")
"""Commands that read no state directory."""
HAND = """requests:
- id: {id}
  services: [{services}]
"""


class Acts(World):
    """A world in which somebody acts."""

    def declare(self, services: dict[str, dict[str, Any]], **kinds: dict[str, dict[str, Any]]) -> None:
        self.specs.update(services)
        write_tree(self.tree, services, **kinds)
        self.engine.log.add("declare", text=", ".join(services))

    def request(self, id: str, *services: str, **more: Any) -> None:
        lease = "ttl" in more
        if not lease:
            self.doubtful.setdefault(id, []).append(services)
        self.call("PUT", f"/v1/requests/{id}", {"services": list(services), **more})
        if not lease:
            self.asked[id] = services
            self.doubtful.pop(id)

    def release(self, id: str) -> None:
        self.doubtful.setdefault(id, []).append(None)
        with contextlib.suppress(NotFound):
            self.call("DELETE", f"/v1/requests/{id}")
        self.asked[id] = None
        self.doubtful.pop(id)

    def first(self, name: str) -> dict[str, str]:
        """Digest and start of the containers of a service at the beginning of the case."""
        return {c.digest: c.started_at for c in self.kept[0].values() if c.service == name}

    def changed(self, name: str) -> None:
        """Wait until its only container is another one than at the beginning, and runs."""

        def look() -> bool:
            found = self.containers(name)
            return [c.state for c in found] == ["running"] and found[0].digest not in self.first(name)

        self.when_alive(look, f"{name} has not changed")

    def successor(self, name: str) -> None:
        """Wait until its change has made another container, which is proven."""
        self.when_alive(lambda: len(self.containers(name)) == 2, f"{name} has no successor")
        self.when_alive(lambda: len(self.containers(name)) == 1, f"the successor of {name} is not proven")

    def command(self, *words: str) -> None:
        """A command of rorg, of which nobody dies but the rorg that it talks to."""
        self.when_alive(self._served, " ".join(words))
        state = ["--state-dir", str(self.state.path)]
        nowhere = {**os.environ, "DOCKER_HOST": f"unix://{self.folder}/no-engine"}
        done = commands.run([*words, "--yes", *state], nowhere, self.folder)
        self.engine.log.add("told", text=f"{' '.join(words)}: exit code {done.returncode} {done.stderr[-200:]}")
        if done.returncode:
            self.when_alive(lambda: False if self._served() else None, done.stderr)

    def killed_command(self, *words: str, code: int = 0) -> None:
        """A command of rorg that is killed at the point of the case. Raises Died if it was."""
        (point, side), self.aim = self.aim, (0, "after")
        for path in (self.command_trace, outcomes_of(self.command_trace)):
            path.unlink(missing_ok=True)
        environment = {**self.environment(point, side), "PROOF_TRACE": str(self.command_trace)}
        with (self.folder / "rorg.log").open("ab") as log:
            files = {"stdout": log, "stderr": log, "program": PROGRAM}
            command = [*words, *(["--state-dir", str(self.state.path)] if words[0] not in ALONE else [])]
            process = Prepared(command, environment, self.folder, **files)  # type: ignore[arg-type]
        ended = process.wait(PATIENCE)
        self.engine.log.add("told", text=f"{' '.join(words)}: exit code {ended}")
        if ended == -signal.SIGKILL:
            raise Died(" ".join(words))
        said = (self.folder / "rorg.log").read_text()[-2000:]
        assert ended == code, f"{' '.join(words)} ends with {ended}\n{said}"

    def load(self, memory: int) -> None:
        """Programs outside rorg use so many bytes from now on."""
        with self.engine.lock:
            self.engine.used = memory
            self.engine.log.add("load", text=f"{memory >> 20} MiB")

    def refused(self, name: str) -> None:
        """Wait until its change was taken back."""

        def look() -> bool:
            found = self.containers(name)
            back = [c.state for c in found] == ["running"] and found[0].digest in self.first(name)
            return back and "Quarantined" in str(self.service(name))

        self.when_alive(look, f"the change of {name} is not taken back")

    def service(self, name: str) -> Any:
        with contextlib.suppress(Error):
            return self.client().call("GET", f"/v1/services/{name}")
        return None

    def withheld(self, name: str) -> None:
        """Wait until rorg says that it keeps a service whose manifest is gone."""

        def look() -> bool:
            with contextlib.suppress(Error):
                return name in self.client().status()["withheld"]
            return False

        self.when_alive(look, f"the removal of {name} is not withheld")

    def restart(self, name: str, *others: str) -> None:
        """Ask for it, and wait until it, and what spreads from it, has begun anew."""
        self.call("POST", f"/v1/services/{name}/restart?force=true")

        def again() -> bool:
            found = [c for n in (name, *others) for c in self.containers(n)]
            return all(c.state == "running" and c.started_at not in self.first(c.service).values() for c in found)

        self.when_alive(again, f"{name} has not begun anew")

    def crash(self, name: str) -> None:
        (found,) = self.containers(name)
        if found.started_at in self.first(name).values() and found.alive:
            self.end_program(found)

    def end_program(self, container: Container) -> None:
        """Behind rorg's back."""
        with self.engine.lock:
            self.engine.sim.kill(container.id)
            now = dict(self.engine.sim.containers)
            self.engine.log.add("crash", container.service, container.id, containers=now)

    def edit_requests(self, id: str, *services: str) -> None:
        """As an editor does it, which replaces the file."""
        self.asked[id] = services
        other = self.state.requests.with_name("edited")
        other.write_text(HAND.format(id=id, services=", ".join(services)))
        os.replace(other, self.state.requests)

    def put_manifest(self, name: str, old: str, new: str) -> None:
        self.when_alive(self._served, "the API")
        client = self.client()
        text = client.manifest("Service", name)
        if new not in text:
            digest = next(m["digest"] for m in client.manifests() if m["name"] == name)
            client.put_manifest("Service", name, text.replace(old, new), digest, f"{old} becomes {new}")
            self.engine.log.add("told", text=f"manifest of {name} is written")

    def delete_manifest(self, name: str) -> None:
        self.gone.add(name)
        self.when_alive(self._served, "the API")
        client = self.client()
        found = [m["digest"] for m in client.manifests() if m["name"] == name]
        if found:
            client.delete_manifest("Service", name, found[0], f"without {name}")

    def git_back(self) -> None:
        """The commit that `rorg rollback` makes."""
        if self.git("log", "-1", "--format=%s") == "second":
            self.git("revert", "--no-edit", "HEAD")

    def commit_upstream(self, name: str, old: str, new: str) -> None:
        path = self.upstream / "services" / f"{name}.yaml"
        if new not in path.read_text():
            path.write_text(path.read_text().replace(old, new))
            self.git("commit", "-qam", "second", folder=self.upstream)
        self.call("POST", "/v1/fetch")

    def down(self) -> None:
        self.gone.update(self.specs)
        if self.document().down:
            return
        self.asked = dict.fromkeys(self.asked)
        self.doubtful = {id: [("cam",), None] for id in self.asked}
        with contextlib.suppress(Refused):
            self.call("PUT", "/v1/down", {})

    def when_gone(self) -> None:
        """Wait until the robot is down: rorg has ended by itself, or says that nothing is left."""

        def gone() -> bool:
            if self.process is None or self.process.poll() == -9:
                raise Died("before the robot was down")
            with contextlib.suppress(Error):
                return bool(self.client().call("GET", "/v1/status")["down"] == "down")
            return self.process.poll() == 0

        try:
            wait_for(gone, PATIENCE, "the robot is down")
        except AssertionError as error:
            raise AssertionError(
                f"{error}; exit code {self.process and self.process.poll()}; {self.states()}"
            ) from None
