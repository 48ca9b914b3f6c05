"""What rorg creates of a whole tree at once, as its loop does one by one, with nothing started."""

from __future__ import annotations

from pathlib import Path

import agreement
import docker

from rorg.core.desired import Desired
from rorg.core.digest import Rules, labels
from rorg.core.objects import object_labels
from rorg.engines.docker.engine import DockerEngine
from rorg.model.joining import resolved


class Creator:
    """An engine, on which projects are made one after the other."""

    def __init__(self, host: str) -> None:
        self.engine = DockerEngine("agreement", host)
        self.api = docker.APIClient(host, version="auto")

    def create(self, desired: Desired, config: agreement.Tree, folder: Path) -> agreement.Tree:
        """All of a tree, in the form of agreement.py; then it is removed again. `config`: what inspect.json says
        of the project's configuration."""
        agreement.make_images(self.api, config["images"])
        agreement.make_external(self.api, config)
        catalog, made = desired.catalog, dict[str, str]()
        objects = [one for one in (*catalog.networks.values(), *catalog.volumes.values()) if not one.external]
        try:
            for one in objects:
                self.engine.make_object(one.kind, one.called, one.spec, object_labels(one, "agreement"))
            for name in desired.order:
                service = catalog.services[name]
                if service.spec is not None:
                    spec = resolved(service.spec, service.joins, made)
                    marks = labels("agreement", name, spec, desired.digests[name], Rules())
                    made[name] = self.engine.create(service.container_name, spec, marks, "", service.defaults)
            names = [catalog.services[name].container_name for name in made]
            return agreement.project(self.api, names, config, folder)
        finally:
            for container in reversed(made.values()):
                self.api.remove_container(container, v=True, force=True)
            for one in objects:
                self.engine.remove_object(one.kind, one.called)
            agreement.remove_external(self.api, config)

    def close(self) -> None:
        self.engine.close()
        self.api.close()
