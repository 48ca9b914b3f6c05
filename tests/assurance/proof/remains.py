"""What a case leaves behind, for the promises."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from histories import integrity
from proof.engine_link import EngineWorld
from proof.promises import STRANGER, Story

from rorg.core.observed import Container
from rorg.images.records import Records
from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir


class Remains:
    """Of a world: its files and its engine."""

    tree: Path
    out: Path
    state: StateDir
    engine: EngineWorld
    process: Any
    specs: dict[str, dict[str, Any]]
    gone: set[str]
    asked: dict[str, Any]
    doubtful: dict[str, list[Any]]
    kept_written: Mapping[str, bytes]

    def found(self) -> dict[str, Container]:
        raise NotImplementedError

    def git(self, *words: str) -> str:
        raise NotImplementedError

    def end(self, status: Mapping[str, Any]) -> dict[str, Any]:
        containers = [c for c in self.found().values() if c.service and c.id != STRANGER]
        document = self.document()
        files = {str(p.relative_to(self.tree)): p.read_text() for p in sorted(self.tree.rglob("*.yaml"))}
        return {
            "containers": sorted((c.service, c.name, c.state, c.digest, str(dict(c.live))) for c in containers),
            "objects": sorted(self.engine.sim.objects),
            "requests": sorted((r.requester, r.id, r.services) for r in document.requests),
            "holds": sorted(document.holds),
            "down": document.down,
            "files": files,
            "commits": self.git("log", "--format=%s") if (self.tree / ".git").exists() else "",
            "uncommitted": self.git("status", "--porcelain") if (self.tree / ".git").exists() else "",
            "left": self.leftovers(),
            "written": self.written(),
            "images": sorted(i.text for i in self.engine.images.images.values()),
            "image records": self.image_records(),
            "damage": self.damage(),
            "services": {n: (s["sync"], s["health"]) for n, s in status.get("services", {}).items()},
        }

    def written(self) -> dict[str, bytes]:
        """The files that commands have written for their user, without those on their way."""
        found = [p for p in sorted(self.out.rglob("*")) if p.is_file()]
        return {str(p.relative_to(self.out)): p.read_bytes() for p in found}

    def image_records(self) -> tuple[Any, ...]:
        """What is recorded of builds and of the images of revisions."""
        records = Records(self.state.path)
        return sorted(b.reference for b in records.built().values()), records.revisions()

    def damage(self) -> str:
        """Of the journal; empty if it is sound, or if there is none."""
        found = integrity(self.state.journal) if self.state.journal.exists() else "ok"
        return "" if found == "ok" else found

    def leftovers(self) -> list[str]:
        """Files on their way to their place, of an rorg that is dead."""
        found = (*self.tree.glob("*/.*"), *self.state.path.glob(".*.*.????????"))
        found += tuple(self.state.path.glob("journal.damaged*"))
        own = f".{self.process.pid}." if self.process else "-"
        return [p.name for p in found if own not in p.name]

    def document(self) -> Any:
        file = RequestsFile(self.state.requests)
        file.read()
        return file.document

    def check_requests(self) -> None:
        """Note in the log what was acknowledged and is not in the file, or is there twice."""
        found = yaml.safe_load(self.state.requests.read_text()) if self.state.requests.exists() else {}
        listed = [(r["id"], tuple(r["services"])) for r in (found or {}).get("requests", ())]
        if len({id for id, _ in listed}) < len(listed):
            self.engine.log.add("lost", text=f"a request is there twice: {listed}")
        for id, services in self.asked.items():
            now = dict(listed).get(id)
            if now != services and now not in self.doubtful.get(id, ()):
                self.engine.log.add("lost", text=f"request {id} is {now}; {services} was acknowledged")

    def check_written(self, wanted: Mapping[str, bytes]) -> None:
        """Note in the log what is neither the old file nor the new one. `wanted`: all of the new ones."""
        before = self.kept_written
        for name, now in self.written().items():
            on_its_way = any(part.startswith(".") for part in Path(name).parts)
            if not on_its_way and now not in (before.get(name), wanted.get(name)):
                self.engine.log.add("half", text=f"{name} is half a file: {now[:60]!r}, {len(now)} bytes")

    def story(self, end: Mapping[str, Any], reference: Story | None) -> Story:
        return Story(self.engine.log.entries, dict(self.specs), frozenset(self.gone), end, reference)
