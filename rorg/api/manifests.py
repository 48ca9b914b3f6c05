"""Manifests through the API: read, validated, written in one step, committed."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from pathlib import Path
from typing import Annotated, Any

from fastapi import FastAPI, Query
from fastapi import Path as Parameter
from fastapi.responses import JSONResponse, Response

from rorg.api.callers import Who, needs
from rorg.api.changes import confirm
from rorg.api.generations import GENERATION, reached
from rorg.api.inputs import PutManifest
from rorg.api.manifest_change import ManifestChange, digest, recover
from rorg.api.manifest_texts import (
    Kept,
    check_name,
    check_tree,
    file_with,
    listed,
    manifests_in,
    manifests_of,
    restored,
)
from rorg.api.models import ManifestView
from rorg.api.operations import Operations
from rorg.api.permissions import Caller, allow_manage, manages
from rorg.api.vet import vet, vet_rendered
from rorg.core.masking import Masker
from rorg.daemon.tree import Tree
from rorg.errors import Busy, Missing, Refused, Unreachable
from rorg.manifest.models import FOLDERS
from rorg.model import image_names
from rorg.model.units import NAME

Kind = Annotated[str, Parameter(pattern="^(" + "|".join(FOLDERS.values()) + ")$")]
ManifestName = Annotated[str, Parameter(pattern=f"{NAME}|{image_names.NAME}", max_length=image_names.LONGEST)]
ONE = "/v1/manifests/{kind}/{name:path}"
"""Names of Images may contain a /."""


class Manifests:
    """The files of a tree. One change at a time."""

    def __init__(self, operations: Operations) -> None:
        self.operations = operations
        self._lock = threading.Lock()

    @property
    def tree(self) -> Tree:
        return self.operations.tree

    @property
    def root(self) -> Path:
        return self.tree.root

    @property
    def note(self) -> Path:
        """The file in which a change is noted while it is carried out."""
        return self.operations.state.manifest_change

    def one(self, kind: str, name: str) -> Kept:
        """A manifest. Raises Missing."""
        manifest = manifests_of(self.root).get((kind, name))
        if manifest is None:
            raise Missing(f"find the {kind} '{name}'", f"no such {kind}", "GET /v1/manifests for all")
        return manifest

    def masker(self, caller: Caller, name: str) -> Masker:
        """Masks the secrets in a manifest. For a service that manages it, only those of the manifest itself: otherwise
        it could find the secrets of other services by writing guesses."""
        masker = self.tree.masker
        return masker.of(name, Masker()) if caller.kind == "service" else masker

    def allow(self, caller: Caller, kind: str, name: str) -> None:
        """Raises Forbidden if a service's own manifest does not allow it."""
        if caller.kind == "service":
            allow_manage(caller, kind, name, self.operations.catalog)

    def put(self, caller: Caller, kind: str, name: str, body: PutManifest) -> tuple[Path, str, int]:
        """Writes a manifest if the whole tree is valid with it and it has not changed meanwhile: (its file, its digest,
        the generation of the change)."""
        self.allow(caller, kind, name)
        self._own(f"change the {kind} '{name}'")
        with self._lock:
            kept = manifests_of(self.root).get((kind, name))
            self._same(kept and kept.text, body.base, f"change the {kind} '{name}'")
            before = (kept.text if kept else b"").decode("utf-8", errors="replace")
            text = restored(before, body.text, self.masker(caller, name), f"change the {kind} '{name}'")
            check_name(kind, name, text)
            whole: str | None = text
            if kept:
                path, whole = kept.path, file_with(kept, kind, name, text)
            else:
                path = self.root / next(f for f, k in FOLDERS.items() if k == kind) / f"{image_names.stem(name)}.yaml"
                if path.is_symlink() or path.exists():
                    raise Refused(
                        f"write the {kind} '{name}'",
                        f"{path.relative_to(self.root)} declares something else",
                        "to rename that file after what it declares",
                    )
            self._check(caller, kind, name, path, text, before=before, whole=whole)
            if body.check:
                return path, "", 0
            message = body.message or f"{kind} {name}: changed through the API"
            generation = self._change(caller, path, kept and kept.content, whole, message)
            return path, digest(manifests_in(path, (whole or "").encode())[kind, name].text), generation

    def _check(
        self, caller: Caller, kind: str, name: str, path: Path, text: str, *, before: str, whole: str | None
    ) -> None:
        """Raises Forbidden if a service may not write this text, before reading any file that it names; and Invalid if
        the tree has mistakes with the file as a `whole`."""
        catalog, root, robot, service = self.operations.catalog, self.root, self.tree.robot, caller.kind == "service"
        if service:
            vet(caller, name, path, text, before=before, catalog=catalog, root=root, robot=robot)
        old, new = check_tree(
            root,
            path,
            whole,
            engine=self.tree.engine,
            what=f"change the {kind} '{name}'",
            robot=robot,
            stranger=service,
        )
        if service:
            vet_rendered(caller, name, path, before=old, after=new, catalog=catalog, root=root, robot=robot)

    def delete(self, caller: Caller, kind: str, name: str, base: str | None, message: str) -> int:
        self.allow(caller, kind, name)
        self._own(f"delete the {kind} '{name}'")
        with self._lock:
            kept = self.one(kind, name)
            self._same(kept.text, base, f"delete the {kind} '{name}'")
            what, service = f"delete the {kind} '{name}'", caller.kind == "service"
            whole = file_with(kept, kind, name, None)
            tree = self.tree
            check_tree(self.root, kept.path, whole, engine=tree.engine, what=what, robot=tree.robot, stranger=service)
            message = message or f"{kind} {name}: deleted through the API"
            return self._change(caller, kept.path, kept.content, whole, message)

    def _own(self, what: str) -> None:
        """Raises Refused if the files are a copy of a repository: the next commit would overwrite the change."""
        source = self.tree.source
        if source is not None:
            shown = source.cache.followed.shown
            raise Refused(what, f"the manifests are those of {shown}", "to commit there, then `rorg apply`")

    def recover(self) -> None:
        """Finishes what a killed rorg had begun to change, in a thread: git may take some time, and other changes
        wait."""
        if self.note.exists():
            self._lock.acquire()
            threading.Thread(target=self._recover, name="manifest-recovery", daemon=True).start()

    def _recover(self) -> None:
        try:
            recovery = recover(self.root, self.note)
        except OSError as error:
            self.operations.recorder.event("manifest-recovery", f"an interrupted change is still unfinished: {error}")
        else:
            if recovery:
                change, outcome = recovery
                self._told(change, f"{change.message} (by {change.author}) was interrupted: {outcome}")
        finally:
            self._lock.release()

    def _same(self, content: bytes | None, base: str | None, what: str) -> None:
        now = None if content is None else digest(content)
        if now != base:
            raise Refused(
                what,
                "it was changed meanwhile" if now and base else "one already exists" if now else "it was deleted",
                f"again, on the version {now}",
            )

    def _change(self, caller: Caller, path: Path, before: bytes | None, text: str | None, message: str) -> int:
        change = ManifestChange(
            str(path.relative_to(self.root)),
            None if before is None else digest(before),
            None if text is None else digest(text.encode()),
            message,
            caller.author,
            caller.person,
        )
        try:
            change.carry_out(self.root, self.note, text)
        except OSError as error:
            raise Unreachable(
                f"write {change.file}", error.strerror or str(error), "to free space on the disk"
            ) from error
        return self._told(change, f"{message} (by {change.author})")

    def _told(self, change: ManifestChange, text: str) -> int:
        self.operations.recorder.event("manifest", text, change.person, author=change.author, file=change.file)
        return self.operations.files_changed(manifest=True)


def add_manifests(app: FastAPI, operations: Operations) -> None:
    """Adds the routes."""
    manifests, allowed = Manifests(operations), [needs("manifests")]
    app.state.manifests = manifests
    _add_reading(app, manifests, allowed)

    @app.put(ONE, dependencies=allowed, response_model=ManifestView)
    def put_one(kind: Kind, name: ManifestName, body: PutManifest, caller: Who) -> Response:
        """Write a manifest: validated with the whole tree, in one step, committed if the tree is a git repository.
        Refused if `base` is not the digest of the current version. With `check`, nothing is written (204)."""
        path, new_digest, generation = manifests.put(caller, kind, name, body)
        if body.check:
            return Response(status_code=204)
        return JSONResponse(
            {
                "kind": kind,
                "name": name,
                "file": str(path.relative_to(manifests.root)),
                "digest": new_digest,
                "generation": generation,
            },
            headers={GENERATION: str(generation)},
        )

    @app.delete(ONE, dependencies=allowed, status_code=204, response_class=Response)
    async def delete_one(
        kind: Kind,
        name: ManifestName,
        caller: Who,
        base: str | None = None,
        message: Annotated[str, Query(max_length=500)] = "",
    ) -> Response:
        """Delete a manifest. Naming it is the confirmation that also removes it while something uses it."""
        generation = await asyncio.to_thread(manifests.delete, caller, kind, name, base, message)
        with contextlib.suppress(Busy):  # the tree is being written; what is withheld is reported, and can be confirmed
            await reached(operations, generation)
            if operations.withheld(kind, name):
                generation = await asyncio.wrap_future(operations.change(caller, confirm(operations.current, (name,))))
        return Response(status_code=204, headers={GENERATION: str(generation)})


def _add_reading(app: FastAPI, manifests: Manifests, allowed: list[Any]) -> None:
    @app.get("/v1/manifests", dependencies=allowed, response_model=list[ManifestView])
    def list_all(caller: Who) -> Response:
        """Every manifest of the tree, with the digest of its text; a service sees those that it may manage."""
        manifests.allow(caller, "Service", "")
        catalog = manifests.operations.catalog
        return JSONResponse(
            [
                entry
                for entry in listed(manifests.root)
                if caller.kind != "service" or manages(caller, entry["kind"], entry["name"], catalog)
            ]
        )

    @app.get(ONE, dependencies=allowed, response_class=Response)
    def get_one(kind: Kind, name: ManifestName, caller: Who) -> Response:
        """The text of a manifest. Its digest is the ETag."""
        manifests.allow(caller, kind, name)
        content = manifests.one(kind, name).text
        text = manifests.masker(caller, name).text(content.decode("utf-8", errors="surrogateescape"))
        shown = text.encode("utf-8", errors="surrogateescape")
        return Response(shown, media_type="application/yaml", headers={"ETag": f'"{digest(content)}"'})
