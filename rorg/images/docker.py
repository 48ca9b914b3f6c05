"""Images on Docker: build with the cache kept, pull, import a root file system."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import requests
import urllib3
from docker.errors import APIError, DockerException

from rorg.engines.docker.engine import DockerEngine
from rorg.engines.docker.errors import REMEDY, refusal
from rorg.errors import EngineError, Unreachable
from rorg.images.build import import_stream
from rorg.model.catalog import Image


@contextlib.contextmanager
def library_errors(what: str) -> Iterator[None]:
    """docker-py's errors as ours."""
    try:
        yield
    except APIError as error:
        raise refusal(what, str(error.explanation or error)) from error
    except (DockerException, requests.RequestException, urllib3.exceptions.HTTPError, OSError, ValueError) as error:
        raise Unreachable(what, str(error), REMEDY) from error


class DockerBuilder:
    """Builds with the engine that also runs what is built."""

    def __init__(self, engine: DockerEngine) -> None:
        self.api = engine.api()

    def has(self, reference: str) -> bool:
        try:
            with library_errors(f"look for {reference}"):
                self.api.inspect_image(reference)
            return True
        except EngineError:
            return False

    def pull(self, reference: str) -> None:
        with library_errors(f"pull {reference}"):
            for line in self.api.pull(reference, stream=True, decode=True):
                if "error" in line:
                    raise EngineError(f"pull {reference}", line["error"], "an Image of that name in the tree")

    def build(self, image: Image, say: Callable[[str], None]) -> None:
        with library_errors(f"build {image.name}"):
            lines = self.api.build(
                path=image.context,
                dockerfile=image.dockerfile,
                tag=image.name,
                rm=True,
                forcerm=True,
                buildargs=dict(image.args),
                network_mode="host",
                decode=True,
            )
            last = ""
            for line in lines:
                if "error" in line:
                    raise EngineError(f"build {image.name}", f"{line['error'].strip()} (at: {last})")
                if line.get("stream", "").startswith("Step "):
                    last = line["stream"].strip()

    def load(self, image: Image) -> None:
        with import_stream(image) as stream, library_errors(f"import {image.name}"):
            self.api.import_image(src=stream, repository=image.name, stream_src=True)

    def remove(self, names: list[str]) -> None:
        """Takes images away again; one that something still uses stays."""
        for name in reversed(names):
            try:
                with library_errors(f"remove {name}"):
                    self.api.remove_image(name, force=True)
            except EngineError:
                continue
