"""Opens, enters and removes dev containers: a service's own image with its mounts and devices, for a person."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rorg.cli.context import Context
from rorg.cli.exec import NO_PROGRAM
from rorg.cli.output import consent, disk_errors, missing, note
from rorg.cli.shell import BASH_OR_SH
from rorg.core.desired import desire
from rorg.core.devices import given
from rorg.engines.docker.dev import DevContainers
from rorg.engines.docker.engine import DockerEngine
from rorg.errors import EngineError, Invalid, Refused
from rorg.host.devices import look
from rorg.host.git import configured_identity
from rorg.host.person import Person, caller
from rorg.images.dev import (
    BASHRC,
    COVERED,
    SCREEN,
    Developer,
    dev_labels,
    dev_spec,
    drift,
    name_for,
    plain_spec,
    within,
)
from rorg.images.devcontainer import document, written_by_rorg
from rorg.images.references import references_for
from rorg.model.catalog import Catalog, Service, Spec
from rorg.model.dev import DevContainer
from rorg.model.engines import capabilities_of
from rorg.model.joining import resolved
from rorg.store.files import locked, make_directory, write_atomic

NAME = re.compile(r"[a-zA-Z0-9][a-zA-Z0-9_.-]+")
"""The names that the engine takes for containers."""


def rows(containers: Sequence[DevContainer]) -> list[dict[str, Any]]:
    """Rows for a listing."""
    return [
        {
            "name": c.name,
            "of": c.of,
            "state": c.state,
            "workspace": c.workspace,
            "user": c.user,
            "extras": ",".join(c.extras),
            "id": c.id,
        }
        for c in containers
    ]


class Wish:
    """The dev container that a command line asks for."""

    def __init__(self, context: Context, name: str, called: str, workspace: Path | None, x11: bool, gpu: bool) -> None:
        """Raises Invalid for a name that does not exist."""
        self.what = f"develop in {name}"
        catalog = context.catalog()
        self.of, self.spec, self.service, self.image = _meant(context, catalog, name, self.what)
        self.name = called or name_for(self.of)
        if not NAME.fullmatch(self.name):
            raise Invalid(self.what, f"'{self.name}' is not a valid container name", "letters, digits, _ . -")
        if any(s.spec is not None and s.container_name == self.name for s in catalog.services.values()):
            raise Invalid(self.what, f"the container of a service is called {self.name}", "--name NAME")
        self.person = caller(os.environ, os.geteuid(), os.getegid())
        self.developer = Developer(
            user=self.person.numbers,
            name=self.person.name,
            workspace=_workspace(workspace),
            home=str(context.state.homes.absolute() / str(self.person.uid) / self.name),
            git=configured_identity(self.person.home),
            display=_display(self.what, self.person) if x11 else None,
            gpu=gpu,
        )


def _meant(context: Context, catalog: Catalog, name: str, what: str) -> tuple[str, Spec, Service | None, str]:
    """(service or image/IMAGE, its rendered container, the service, the image that builds it). Raises Invalid."""
    content = references_for(context.engine_name, context.state.path).of(catalog)
    rendered = desire(catalog, str(context.state.run), images=content.references).catalog.services
    services = {n: (s, s.spec) for n, s in rendered.items() if s.spec is not None}
    images = {*catalog.images, *(content.named(spec["image"]) for _, spec in services.values())}
    if (short := name.removeprefix("service/")) in services:
        service, declared = services[short]
        # It joins the containers with these names when it is made, whether or not the service itself runs.
        names = {n: rendered[n].container_name for n in service.joins}
        spec = resolved(_plugged(what, service, declared), service.joins, names)
        return short, spec, service, content.named(str(spec["image"]))
    if (short := name.removeprefix("image/")) in images:
        return f"image/{short}", plain_spec(content.references.get(short, short)), None, short
    if short in catalog.groups:
        raise Invalid(what, f"{short} is a group", "one of " + ", ".join(catalog.groups[short].services))
    if short in catalog.services:
        raise Invalid(what, f"{short} is a meta-service, which has no container", "a service that has one")
    raise missing("service or image", name, {*services, *images})


def _plugged(what: str, service: Service, spec: Spec) -> Spec:
    """Its container, with the current nodes of its devices. Raises Invalid for an unplugged one."""
    devices = look(service.devices)
    for device, now in devices.items():
        if now.problem:
            raise Invalid(what, f"{device} {now.problem}", "to plug it in")
    return given(spec, service, devices)


def _workspace(given: Path | None) -> str:
    """The absolute workspace. Raises Invalid."""
    path = os.path.abspath(given or os.getcwd())
    what = f"work in {path}"
    if not os.path.isdir(path):
        raise Invalid(what, "there is no such directory", "another directory with --workspace")
    if path in COVERED:
        raise Invalid(what, "it would hide what the image has there", "a directory below it, with --workspace")
    return path


def _display(what: str, person: Person) -> dict[str, str]:
    """DISPLAY, with its cookies and sockets if there are any (a screen over TCP has none). Raises Invalid."""
    if not os.environ.get("DISPLAY"):
        raise Invalid(f"{what} with X11", "DISPLAY is not set: there is no screen", "the same without --x11")
    files = {"XAUTHORITY": os.environ.get("XAUTHORITY") or f"{person.home}/.Xauthority", "SOCKETS": SCREEN}
    return {"DISPLAY": os.environ["DISPLAY"], **{k: path for k, path in files.items() if os.path.exists(path)}}


def _named(container: DevContainer, of: str | None, called: str) -> bool:
    """Whether a command line means it: by its service or image, by its name, or because it names nothing."""
    if of is None:
        return called in ("", container.name)
    same = of in (container.of, container.of.removeprefix("image/"))
    return container.name == of or (same and container.name == (called or name_for(container.of)))


class Developing:
    """The dev containers of one robot."""

    def __init__(self, context: Context) -> None:
        """Raises Refused if only the socket is known, and Invalid if the engine has no containers on this machine."""
        what = "open a dev container"
        context.here(what)
        engine = context.engine() if capabilities_of(context.engine_name).images else None
        if not isinstance(engine, DockerEngine):
            raise Invalid(what, f"the {context.engine_name} engine has none", "--engine docker")
        if not engine.local:
            raise Invalid(what, "the engine is on another machine, and the workspace is here", "it there")
        self.context, self.engine, self.containers = context, engine, DevContainers(engine)

    def stop(self, name: str | None, called: str) -> None:
        """Stops and removes the container that the same command line would enter, or all if it names none."""
        of = name and name.removeprefix("service/")
        containers = [c for c in self.containers.list() if _named(c, of, called)]
        for container in containers:
            note(
                f"{container.name} of {container.of} ({container.state}, {container.workspace}) is stopped and removed"
            )
        for container in containers:
            self.containers.remove(container)
        if not containers:
            note(f"nothing to stop: no dev container{f' of {of}' if of else ''}")

    def enter(self, wish: Wish, command: Sequence[str], fresh: bool, yes: bool) -> int:
        """The exit code of a shell or of the command in the container, which is made if it is missing."""
        self._consent(wish, yes)
        self.context.state.prepare()
        homes = self.context.state.homes
        with self.context.state.usable():
            make_directory(homes, 0o755)
        with self.context.state.usable(), locked(homes / "lock"):  # two commands that start together make one container
            container = next((c for c in self.containers.list() if c.name == wish.name), None)
            if container is not None:
                self._check(wish, container)
            if container is None or fresh:
                container = self._make(wish, container)
            else:
                self._tell_drift(wish, container)
                self.containers.start(container)
        inside = within(wish.developer.workspace, container.workspace)
        folder = wish.developer.workspace if inside else container.workspace
        terminal = os.isatty(0) and os.isatty(1)
        code = self.containers.run(container, command or BASH_OR_SH, terminal, folder)
        if code == NO_PROGRAM and command:
            remedy = f"try `rorg dev {wish.of}` to look around"
            note(f"rorg: {command[0]} in {container.name} gave 127: no such program; {remedy}")
        return code

    def _consent(self, wish: Wish, yes: bool) -> None:
        """Raises Refused unless someone agrees that a second program may use the hardware of a running driver."""
        service = wish.service
        if yes or service is None or not (service.driver or service.protected):
            return
        if any(c.service == service.name and c.alive for c in self.engine.list()):
            why = f"{service.name} runs, and may not share what it drives (`rorg hold {service.name} --for 1h` ends it)"
            consent(wish.what, f"{why}. Go on?", f"{why}; it needs confirmation")

    def _check(self, wish: Wish, container: DevContainer) -> None:
        """Raises Refused for a container of another user, service or image."""
        for theirs, ours_ in ((container.of, wish.of), (f"user {container.user}", f"user {wish.developer.user}")):
            if theirs != ours_:
                raise Refused(wish.what, f"{container.name} belongs to {theirs}, not to {ours_}", "--name NAME")

    def _tell_drift(self, wish: Wish, container: DevContainer) -> None:
        image = self.containers.image(wish.spec["image"])
        why = drift(container, wish.spec, image, wish.developer.workspace, wish.developer.extras)
        if why:
            named = ["--name", wish.name] if wish.name != name_for(wish.of) else []
            line = ["rorg dev", wish.of, *named, *(f"--{extra}" for extra in wish.developer.extras), "--fresh"]
            note(f"{container.name}: {'; '.join(why)}; `{' '.join(line)}` renews it")

    def _make(self, wish: Wish, before: DevContainer | None) -> DevContainer:
        """Makes a new container in place of the previous one. Raises EngineError; then the previous one is
        unchanged."""
        image = self.containers.image(wish.spec["image"])
        if not image:
            remedy = f"`rorg build {wish.image}`"
            raise EngineError(wish.what, f"no image {wish.spec['image']} on this machine", remedy, "missing_image")
        self._make_home(wish)
        spec = dev_spec(self._there(wish.spec), wish.name, wish.developer)
        labels = dev_labels(self.engine.owner, wish.of, wish.spec, image, wish.developer)
        return self.containers.make(wish.name, spec, labels, before)

    def _there(self, spec: Spec) -> Spec:
        """The container without the directory of the service's socket if no rorg has made it: the engine would make it
        as root."""
        sockets = f"{self.context.state.run}/"
        kept = [
            v
            for v in spec.get("volumes", ())
            if not (isinstance(v, str) and v.startswith(sockets) and not os.path.isdir(v.partition(":")[0]))
        ]
        return {**spec, "volumes": kept}

    def _make_home(self, wish: Wish) -> None:
        """Makes its home the first time, with a pleasant shell. Raises Invalid."""
        home, person = Path(wish.developer.home), wish.person
        with self.context.state.usable():
            if home.is_dir():
                return
            make_directory(home, 0o700)
            (home / ".bashrc").write_text(BASHRC)
            if os.geteuid() == 0:
                for path in (home / ".bashrc", home):
                    os.chown(path, person.uid, person.gid)

    def write(self, wish: Wish, yes: bool) -> None:
        """Writes the container's file for editors. Raises Refused for a file that rorg did not write."""
        path = Path(wish.developer.workspace) / ".devcontainer" / "devcontainer.json"
        what, person = f"write {path}", wish.person
        with disk_errors(what, "another --workspace"):
            foreign = path.exists() and not written_by_rorg(path.read_bytes())
            if foreign and not yes:
                consent(what, f"{path} is not rorg's. Overwrite it?", "that file is not rorg's")
            self.context.state.prepare()
            self._make_home(wish)
            spec = dev_spec(self._there(wish.spec), wish.name, wish.developer)
            configuration, left = document(wish.name, wish.of, spec)
            if not path.parent.is_dir():
                path.parent.mkdir()
                os.chown(path.parent, person.uid, person.gid)
            write_atomic(path, json.dumps(configuration, indent=2) + "\n", mode=0o644, owner=(person.uid, person.gid))
        note(f"{path} is written" + (f"; it cannot express {', '.join(left)}" if left else ""))
